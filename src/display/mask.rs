//! A mask that the service proposes: sources that stay where they are in the picture while the sky moves are no stars.

use super::frame::Geometry;
use crate::settings::MaskSettings;
use crate::sky::{Attitude, separation};
use crate::solve::Outcome;
use serde::Serialize;

/// A source is at the same place within this distance, px: a star moves by more while the sky moves.
const SAME_PLACE_PX: f64 = 1.5;
/// The sky has moved where the boresight went so far, px: many times the distance above.
const MOVED_PX: f64 = 20.0;
/// A source that stayed in so many frames, the sky having moved from each to the next, is fixed: a chance neighbour is none.
const STAYS: u32 = 4;
/// A place where nothing was seen in this many solved frames is forgotten.
const FORGOTTEN_AFTER: u32 = 30;
/// Places that are remembered.
const PLACES: usize = 512;
/// Blocks that the command for masks can name.
const COMMAND_BLOCKS: usize = 96;

/// A place of the picture at which there was a source that was no star.
#[derive(Debug, Clone, PartialEq)]
struct Place {
    x: f64,
    y: f64,
    /// Where the camera pointed when it was last counted.
    pointing: Attitude,
    /// Frames that counted.
    stays: u32,
    /// Solved frames since it was seen.
    unseen: u32,
}

/// A mask that is proposed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Proposal {
    /// The words of the mask, with what is masked already.
    pub fields: Vec<u32>,
    /// Blocks that it adds: column, and row from the bottom.
    pub added: Vec<[usize; 2]>,
    /// Where the fixed sources are in the picture: x right, y down from the top row, px.
    pub sources: Vec<[f64; 2]>,
    /// The command that sets it; null where it can't name so many blocks.
    pub command: Option<String>,
}

/// Watches for sources that stay.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FixedSources {
    places: Vec<Place>,
    geometry: Option<(usize, usize, bool)>,
}

impl FixedSources {
    /// Takes a frame's outcome. Only one that was solved shows whether the sky moved.
    pub fn take(&mut self, outcome: &Outcome, geometry: &Geometry) {
        let Some(solution) = &outcome.solution else { return };
        let size = Some((geometry.width, geometry.height, geometry.top_first));
        if self.geometry != size {
            *self = Self { geometry: size, places: Vec::new() };
        }
        self.places.iter_mut().for_each(|place| place.unseen = place.unseen.saturating_add(1));
        for (id, source) in outcome.sources.iter().enumerate() {
            let has_room = self.places.len() < PLACES;
            let is_star = solution.matches.iter().any(|pair| pair.source == id);
            if is_star || !source.x.is_finite() || !source.y.is_finite() {
                continue;
            }
            let near = self.places.iter_mut().find(|place| (place.x - source.x).hypot(place.y - source.y) <= SAME_PLACE_PX);
            match near {
                Some(place) => {
                    place.unseen = 0;
                    let moved = separation(&place.pointing.boresight(), &solution.attitude.boresight()) / solution.platescale;
                    if moved >= MOVED_PX {
                        (place.stays, place.pointing) = (place.stays.saturating_add(1), solution.attitude);
                    }
                }
                None if has_room => {
                    let (x, y, pointing) = (source.x, source.y, solution.attitude);
                    self.places.push(Place { x, y, pointing, stays: 1, unseen: 0 });
                }
                None => {}
            }
        }
        self.places.retain(|place| place.unseen < FORGOTTEN_AFTER);
    }

    /// A mask with the blocks of fixed sources besides those that are masked; `None` where it would add none.
    pub fn propose(&self, settings: &MaskSettings, geometry: &Geometry) -> Option<Proposal> {
        let block_px = usize::try_from(settings.block_px).ok().filter(|px| *px > 0)?;
        let (columns, rows) = (geometry.width / block_px, geometry.height / block_px);
        let masked = |fields: &[u32], block: usize| fields.get(block / 32).is_some_and(|word| word >> (block % 32) & 1 == 1);
        let mut fields = if settings.enabled { settings.fields.clone() } else { Vec::new() };
        fields.resize(fields.len().max((columns * rows).div_ceil(32)), 0);
        let (mut added, mut sources) = (Vec::new(), Vec::new());
        for place in self.places.iter().filter(|place| place.stays >= STAYS) {
            let last = geometry.height as f64 - 1.0;
            let (from_top, up) = if geometry.top_first { (place.y, last - place.y) } else { (last - place.y, place.y) };
            let (column, row) = ((place.x.max(0.0) as usize) / block_px, (up.max(0.0) as usize) / block_px);
            if column >= columns || row >= rows {
                continue; // It lies outside the whole blocks, which can't be masked.
            }
            sources.push([place.x, from_top]);
            let block = row * columns + column;
            if !masked(&fields, block)
                && let Some(word) = fields.get_mut(block / 32)
            {
                *word |= 1 << (block % 32);
                added.push([column, row]);
            }
        }
        if added.is_empty() {
            return None;
        }
        let word = |place: usize| fields.get(place).copied().unwrap_or_default();
        let command = (columns * rows <= COMMAND_BLOCKS).then(|| format!("solver.mask 1 {} {} {}", word(0), word(1), word(2)));
        Some(Proposal { fields, added, sources, command })
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::outcome;
    use super::*;
    use crate::sky::{ARCSEC, RowOrder};
    use crate::solve::Reason;

    const GEOMETRY: Geometry = Geometry { width: 1536, height: 1024, top_first: false, mirrored: false };

    fn mask(fields: &[u32]) -> MaskSettings {
        MaskSettings { enabled: !fields.is_empty(), block_px: 128, fields: fields.to_vec() }
    }

    /// A solved frame that points `px` pixels further, with a source at a fixed place and one that goes with the sky.
    fn frame(px: f64) -> Outcome {
        let (mut outcome, _) = outcome(Reason::Solved);
        let solution = outcome.solution.as_mut().unwrap();
        solution.attitude = Attitude::from_angles(1.0, 0.5 + px * 9.5 * ARCSEC, 0.0);
        outcome.sources[0].x = 150.0 + 0.3 * (px % 2.0);
        outcome.sources[0].y = 200.0;
        outcome.sources[2].x = 300.0 + px;
        outcome
    }

    #[test]
    fn a_source_that_stays_while_the_sky_moves_has_its_block_proposed_with_the_command() {
        let mut fixed = FixedSources::default();
        for step in 0..4 {
            assert_eq!(fixed.propose(&mask(&[]), &GEOMETRY), None, "after {step} frames");
            fixed.take(&frame(f64::from(step) * 30.0), &GEOMETRY);
        }
        // Block 13: second from the left, second from the bottom.
        let proposal = fixed.propose(&mask(&[]), &GEOMETRY).unwrap();
        assert_eq!((proposal.fields, proposal.added), (vec![1 << 13, 0, 0], vec![[1, 1]]));
        assert_eq!(proposal.command.as_deref(), Some("solver.mask 1 8192 0 0"));
        assert_eq!(proposal.sources, [[150.0, 1023.0 - 200.0]]);
        let besides = fixed.propose(&mask(&[1, 0, 4]), &GEOMETRY).unwrap();
        assert_eq!(besides.command.as_deref(), Some("solver.mask 1 8193 0 4"));
        assert_eq!(fixed.propose(&mask(&[1 << 13, 0, 0]), &GEOMETRY), None, "it is masked already");
    }

    #[test]
    fn while_the_sky_stands_still_nothing_is_known_of_a_source() {
        let mut fixed = FixedSources::default();
        (0..20).for_each(|_| fixed.take(&frame(0.0), &GEOMETRY));
        assert_eq!(fixed.propose(&mask(&[]), &GEOMETRY), None);
        let mut unsolved = FixedSources::default();
        for step in 0..20 {
            let outcome = Outcome { solution: None, ..frame(f64::from(step) * 30.0) };
            unsolved.take(&outcome, &GEOMETRY);
        }
        assert_eq!(unsolved, FixedSources::default());
    }

    #[test]
    fn a_source_that_went_is_forgotten_and_another_camera_begins_anew() {
        let mut fixed = FixedSources::default();
        (0..4).for_each(|step| fixed.take(&frame(f64::from(step) * 30.0), &GEOMETRY));
        for step in 4..4 + FORGOTTEN_AFTER {
            let mut gone = frame(f64::from(step) * 30.0);
            gone.sources.remove(0);
            // The star is the first of those that are left.
            gone.solution.as_mut().unwrap().matches[0].source = 0;
            fixed.take(&gone, &GEOMETRY);
        }
        assert_eq!(fixed.propose(&mask(&[]), &GEOMETRY), None);
        (0..4).for_each(|step| fixed.take(&frame(f64::from(step) * 30.0), &GEOMETRY));
        let other = Geometry::new(1280, 1024, RowOrder::TopFirst, false);
        fixed.take(&frame(0.0), &other);
        assert_eq!(fixed.propose(&mask(&[]), &other), None);
    }

    #[test]
    fn an_image_of_more_blocks_than_the_command_can_name_has_the_fields_alone() {
        let large = Geometry { width: 4096, height: 4096, ..GEOMETRY };
        let mut fixed = FixedSources::default();
        (0..4).for_each(|step| fixed.take(&frame(f64::from(step) * 30.0), &large));
        let proposal = fixed.propose(&mask(&[]), &large).unwrap();
        assert_eq!((proposal.command, proposal.fields.len()), (None, 32));
        assert_eq!(proposal.added, [[1, 1]]);
    }
}
