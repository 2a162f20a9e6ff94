//! What sources are searched with: kernels as wide and as long as stars may look.

use super::measure::Shape;
use super::peaks::Taps;
use super::trails;

/// The kernel of a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SearchKernel {
    /// For stars as sharp as the optics make them.
    Sharp,
    /// Round, in the picture halved `scale` times.
    Round {
        /// Times that the picture is halved.
        scale: usize,
    },
    /// Along a direction, in the picture halved `scale` times.
    Trail {
        /// Times that the picture is halved.
        scale: usize,
        /// In eighths of half a turn, from x towards y.
        direction: usize,
    },
}

impl SearchKernel {
    /// Times that the picture is halved in which sources are measured.
    pub fn scale(self) -> usize {
        match self {
            Self::Sharp => 0,
            Self::Round { scale } | Self::Trail { scale, .. } => scale,
        }
    }

    /// Times that the picture is halved in which peaks are searched: sharp stars are as well found with half the samples.
    pub(super) fn search_scale(self) -> usize {
        self.scale().max(1)
    }

    /// The smoothing.
    pub(super) fn taps(self) -> Taps {
        if self == Self::Sharp { Taps::SHARP } else { Taps::WIDE }
    }

    /// Distance of the ring that tells the level, coarse cells.
    pub(super) fn ring(self) -> usize {
        if self == Self::Sharp { 1 } else { 2 }
    }

    /// The direction of a trail, of any length.
    pub(super) fn along(self) -> Option<(f32, f32)> {
        match self {
            Self::Sharp | Self::Round { .. } => None,
            Self::Trail { direction, .. } => Some(trails::along(direction)),
        }
    }

    /// The shape that a star is taken for at first, samples².
    pub(super) fn shape(self) -> Shape {
        match self {
            Self::Sharp | Self::Round { .. } => Shape::round(1.0),
            Self::Trail { direction, .. } => trails::shape_of(direction),
        }
    }
}
