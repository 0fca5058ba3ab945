//! Why the best alignment of two maps was not accepted.

/// Reason why the best alignment of two maps was not accepted: the first threshold that it fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum AlignmentRefusal {
    /// The maps share too little floor.
    LittleOverlap = 1,
    /// Too few walls are in both maps.
    FewWalls = 2,
    /// Walls of one map lie on the floor of the other.
    Contradicted = 3,
    /// Too few walls or cells agree.
    LittleAgreement = 4,
    /// Too little furniture, doors and niches are in both maps: long walls are like others.
    FewShortWalls = 5,
    /// One map can slide along the other, as in a corridor.
    Slides = 6,
    /// Another place is nearly as good.
    OtherPlace = 7,
    /// The walls agree little better than at wrong places.
    Chance = 8,
    /// It awaits a second alignment of grown maps at the same place.
    SecondAwaited = 9,
    /// The operator or later maps rejected it.
    Rejected = 10,
}

impl AlignmentRefusal {
    /// All reasons, in the order of their codes.
    pub const ALL: [Self; 10] = [
        Self::LittleOverlap,
        Self::FewWalls,
        Self::Contradicted,
        Self::LittleAgreement,
        Self::FewShortWalls,
        Self::Slides,
        Self::OtherPlace,
        Self::Chance,
        Self::SecondAwaited,
        Self::Rejected,
    ];

    /// Decodes a reason; `None` for an unknown code, and for 0, which means none.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| *reason as u32 == code)
    }

    /// Returns the reason in words.
    pub fn text(self) -> &'static str {
        match self {
            Self::LittleOverlap => "they share too little floor",
            Self::FewWalls => "too few walls are in both maps",
            Self::Contradicted => "walls of one lie on the floor of the other at the best place",
            Self::LittleAgreement => "too few walls agree at the best place",
            Self::FewShortWalls => "too little furniture, doors and niches are in both maps",
            Self::Slides => "one map can slide along the other, as in a corridor",
            Self::OtherPlace => "two places are nearly equally good",
            Self::Chance => "walls agree little better than at wrong places",
            Self::SecondAwaited => "a second alignment of grown maps is awaited",
            Self::Rejected => "the operator or later maps rejected the place",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_is_read_again() {
        for reason in AlignmentRefusal::ALL {
            assert_eq!(AlignmentRefusal::from_code(reason as u32), Some(reason));
        }
        assert_eq!([0, 11].map(AlignmentRefusal::from_code), [None, None]);
    }
}
