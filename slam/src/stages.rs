//! The stages of SLAM's work, told to whoever wants to time them: SLAM itself knows no clock.

/// A part of the work, in the order of a scan's way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Scan path: the scan becomes surfaces.
    Cloud,
    /// Scan path: correlative search in the local map.
    Search,
    /// Scan path: fine alignment.
    Align,
    /// Scan path: the scan becomes a node, the local maps grow.
    Node,
    /// Beside it: a node is tied to others that see the same surfaces.
    Link,
    /// Beside it: places seen before are looked for.
    Closure,
    /// Beside it: the pose graph is solved.
    Solve,
    /// Beside it: the map is drawn.
    Draw,
    /// Nothing of the above.
    Idle,
}

impl Stage {
    /// All of them, by their discriminants.
    pub const ALL: [Self; 9] = [
        Self::Cloud,
        Self::Search,
        Self::Align,
        Self::Node,
        Self::Link,
        Self::Closure,
        Self::Solve,
        Self::Draw,
        Self::Idle,
    ];

    /// One word for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cloud => "cloud",
            Self::Search => "search",
            Self::Align => "align",
            Self::Node => "node",
            Self::Link => "link",
            Self::Closure => "closure",
            Self::Solve => "solve",
            Self::Draw => "draw",
            Self::Idle => "idle",
        }
    }
}

/// Hears which stage begins; the one before has then ended.
pub trait StageObserver: Send {
    /// Called on the thread that does the work.
    fn stage_started(&mut self, stage: Stage);
}

/// Nobody listens.
impl StageObserver for () {
    fn stage_started(&mut self, _: Stage) {}
}
