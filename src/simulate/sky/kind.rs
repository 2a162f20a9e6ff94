//! The kinds of frame.

use crate::solve::Cause;
use std::fmt;
use std::str::FromStr;

/// What is in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Dark sky of 15 to 60 ADU over bias, a mild gradient, 40 hot pixels, 7 dust spots.
    Night,
    /// Daytime sky at float, 1150 to 1800 ADU over bias, otherwise as night.
    Float,
    /// Float with strong gradients, glow, vignetting, mesospheric clouds, sharp-edged reflections, satellites.
    Gradient,
    /// Float with stars as discs of 2 to 12 px.
    Defocus,
    /// Stars as discs of 26 to 33 px, on a dark or a bright sky.
    Defocus30,
    /// Float with trails of 5 to 30 px, straight or curved, whole or with gaps.
    Motion,
    /// Sum of four exposures with 0.5 to 6 px of motion.
    MultiExp,
    /// Float with hundreds of hot pixels, cosmic rays and a dead column.
    HotPix,
    /// Float, within 20° of a galactic pole.
    Sparse,
    /// Float, within 4° of the galactic plane.
    Dense,
    /// A blooming star, or a part of the frame clipped.
    Saturated,
    /// All artefacts and no star: no solution is right.
    NoStars,
    /// Flat, zero or full scale: no solution is right.
    Blank,
    /// Float with stars so dimmed that 3 to 6 of them are over SNR 5.
    Faint,
    /// Float without a star, and clusters of points that look like stars: no solution is right.
    Clustered,
    /// Float without a star, and points that look like stars along lines: no solution is right.
    Linear,
    /// A frame spoilt by one cause, so that it is mostly not solved: what the outcome should name.
    Spoilt(Cause),
}

impl Kind {
    /// All kinds, in the order of the documentation.
    pub const ALL: [Self; 28] = [
        Self::Night,
        Self::Float,
        Self::Gradient,
        Self::Defocus,
        Self::Defocus30,
        Self::Motion,
        Self::MultiExp,
        Self::HotPix,
        Self::Sparse,
        Self::Dense,
        Self::Saturated,
        Self::NoStars,
        Self::Blank,
        Self::Faint,
        Self::Spoilt(Cause::Overexposed),
        Self::Spoilt(Cause::Saturated),
        Self::Spoilt(Cause::NoContrast),
        Self::Spoilt(Cause::OutOfFocus),
        Self::Spoilt(Cause::Trailed),
        Self::Spoilt(Cause::Clouds),
        Self::Spoilt(Cause::TooFewStars),
        Self::Spoilt(Cause::TooManyArtefacts),
        Self::Spoilt(Cause::WrongPlatescale),
        Self::Spoilt(Cause::Mirrored),
        Self::Spoilt(Cause::WrongPrior),
        Self::Spoilt(Cause::LensCovered),
        Self::Clustered,
        Self::Linear,
    ];

    /// The name, as on the command line and in file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Night => "night",
            Self::Float => "float",
            Self::Gradient => "gradient",
            Self::Defocus => "defocus",
            Self::Defocus30 => "defocus30",
            Self::Motion => "motion",
            Self::MultiExp => "multiexp",
            Self::HotPix => "hotpix",
            Self::Sparse => "sparse",
            Self::Dense => "dense",
            Self::Saturated => "saturated",
            Self::NoStars => "nostars",
            Self::Blank => "blank",
            Self::Faint => "faint",
            Self::Clustered => "clustered",
            Self::Linear => "linear",
            Self::Spoilt(Cause::Overexposed) => "cause-overexposed",
            Self::Spoilt(Cause::Saturated) => "cause-saturated",
            Self::Spoilt(Cause::NoContrast) => "cause-no_contrast",
            Self::Spoilt(Cause::OutOfFocus) => "cause-out_of_focus",
            Self::Spoilt(Cause::Trailed) => "cause-trailed",
            Self::Spoilt(Cause::Clouds) => "cause-clouds",
            Self::Spoilt(Cause::TooFewStars) => "cause-too_few_stars",
            Self::Spoilt(Cause::TooManyArtefacts) => "cause-too_many_artefacts",
            Self::Spoilt(Cause::WrongPlatescale) => "cause-wrong_platescale",
            Self::Spoilt(Cause::Mirrored) => "cause-mirrored",
            Self::Spoilt(Cause::WrongPrior) => "cause-wrong_prior",
            Self::Spoilt(Cause::LensCovered) => "cause-lens_covered",
        }
    }

    /// Whether there are stars in it, so that a solution can be right.
    pub fn has_stars(self) -> bool {
        let none = [Self::NoStars, Self::Blank, Self::Clustered, Self::Linear];
        let spoilt = [Self::Spoilt(Cause::LensCovered), Self::Spoilt(Cause::NoContrast)];
        !none.contains(&self) && !spoilt.contains(&self)
    }

    /// What spoils it.
    pub fn cause(self) -> Option<Cause> {
        match self {
            Self::Spoilt(cause) => Some(cause),
            _ => None,
        }
    }

    /// Its place among all kinds, by which the draws of one kind differ from another's.
    pub(super) fn number(self) -> u64 {
        Self::ALL.iter().position(|kind| *kind == self).unwrap_or(Self::ALL.len()) as u64
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is no kind of frame.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` is no kind of frame; expected one of {}", Kind::ALL.map(Kind::name).join(", "))]
pub struct UnknownKind {
    /// The name as given.
    pub name: String,
}

impl FromStr for Kind {
    type Err = UnknownKind;

    fn from_str(name: &str) -> Result<Self, UnknownKind> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| UnknownKind { name: name.to_owned() })
    }
}
