//! Stages of SLAM's work, reported to an observer that may time them: SLAM itself knows no clock.

/// A stage of the work, in the order in which a scan passes them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Front end: the scan becomes surfaces.
    Cloud,
    /// Front end: correlative search in the local map.
    Search,
    /// Front end: fine alignment.
    Align,
    /// Front end: the scan becomes a node, the local maps grow.
    Node,
    /// Back end: a node is linked to others that see the same surfaces.
    Link,
    /// Back end: loop closures are searched for.
    Closure,
    /// Back end: the pose graph is solved.
    Solve,
    /// Back end: the map is drawn.
    Draw,
    /// No stage: there is no work.
    Idle,
}

impl Stage {
    /// All stages, by their discriminants.
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

    /// Name of the stage, one word for tables.
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

/// Receives which stage begins; the one before has then ended.
pub trait StageObserver: Send {
    /// Called on the thread that does the work.
    fn stage_started(&mut self, stage: Stage);
}

/// Ignores all stages.
impl StageObserver for () {
    fn stage_started(&mut self, _: Stage) {}
}
