//! A grid over the sky: which stars are near a direction.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: every index is made from the grid's own tables")]

use super::Pace;
use super::cache::{FieldFileError, Loader, Saver, are_offsets, sane};
use crate::sky::{Vec3, ra_dec, wrap_two_pi};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::io;
use std::ops::Range;

/// Bands of declination, each cut into cells of about equal width in right ascension.
///
/// Holds no stars, only where each cell's stars stand in a list sorted by cell.
#[derive(Debug, Clone)]
pub struct SkyGrid {
    band_height: f64,
    /// First cell of each band, and one past the last.
    first_cell: Vec<u32>,
    /// Where each cell's items begin in the sorted list, and the list's length.
    offsets: Vec<u32>,
}

impl SkyGrid {
    /// Sorts directions into cells about `cell` rad wide; returns the grid and the order: `order[i]` is the item that comes i-th.
    /// `None` where the pace ends it.
    ///
    /// Items of one cell keep their order.
    pub fn build(directions: &[Vec3], cell: f64, pace: &mut Pace<'_>) -> Option<(Self, Vec<u32>)> {
        let mut grid = Self::empty(cell);
        let mut cells = Vec::with_capacity(directions.len());
        for direction in directions {
            pace.step(1)?;
            cells.push(grid.cell_of(direction) as u32);
        }
        let offsets = &mut grid.offsets;
        for &cell in &cells {
            offsets[cell as usize + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut next = offsets.clone();
        let mut order = vec![0u32; directions.len()];
        for (item, &cell) in cells.iter().enumerate() {
            order[next[cell as usize] as usize] = item as u32;
            next[cell as usize] += 1;
        }
        Some((grid, order))
    }

    /// The cells of a grid without items.
    fn empty(cell: f64) -> Self {
        // Cells from 20° down to 0.1°: smaller ones would be empty, and there would be millions of them.
        const BANDS: Range<f64> = 8.0..1800.0;
        let bands = (PI / cell).ceil().clamp(BANDS.start, BANDS.end) as usize;
        let band_height = PI / bands as f64;
        let mut first_cell = vec![0u32];
        for band in 0..bands {
            let low = -FRAC_PI_2 + band as f64 * band_height;
            // The band's longest circle: cells there are as wide as the band is high.
            let widest = if low <= 0.0 && low + band_height >= 0.0 { 1.0 } else { low.cos().max((low + band_height).cos()) };
            let cells = (TAU * widest / band_height).ceil().max(1.0) as u32;
            first_cell.push(first_cell[band] + cells);
        }
        let offsets = vec![0u32; first_cell[bands] as usize + 1];
        Self { band_height, first_cell, offsets }
    }

    /// Writes where each cell's items begin; the cells themselves follow from their width.
    pub fn save(&self, saver: &mut Saver<'_>) -> io::Result<()> {
        saver.list(&self.offsets, |offset| offset.to_le_bytes())
    }

    /// Reads a grid of `items` items in cells about `cell` rad wide.
    pub fn load(loader: &mut Loader<'_>, cell: f64, items: usize) -> Result<Self, FieldFileError> {
        let mut grid = Self::empty(cell);
        let offsets = loader.list(|bytes| u32::from_le_bytes(*bytes))?;
        sane("cells", offsets.len() == grid.offsets.len() && are_offsets(&offsets, items))?;
        grid.offsets = offsets;
        Ok(grid)
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.first_cell[..]) + size_of_val(&self.offsets[..])
    }

    /// Where a cell's items begin in the sorted list.
    pub fn first(&self, cell: usize) -> usize {
        self.offsets[cell] as usize
    }

    /// Number of cells.
    pub fn cells(&self) -> usize {
        self.offsets.len() - 1
    }

    /// The cell that a direction lies in.
    pub fn cell_of(&self, direction: &Vec3) -> usize {
        let (ra, dec) = ra_dec(direction);
        let bands = self.first_cell.len() - 1;
        let band = (((dec + FRAC_PI_2) / self.band_height) as usize).min(bands - 1);
        let (start, cells) = self.band(band);
        start + ((ra / TAU * cells as f64) as usize).min(cells - 1)
    }

    /// Calls `visit` with every cell that may hold a direction within `radius` rad of `centre`.
    pub fn cells_near(&self, centre: &Vec3, radius: f64, mut visit: impl FnMut(usize)) {
        let (ra, dec) = ra_dec(centre);
        let bands = self.first_cell.len() - 1;
        let to_band = |angle: f64| (((angle + FRAC_PI_2) / self.band_height).max(0.0) as usize).min(bands - 1);
        // Half the width in right ascension of a circle that does not reach a pole: sin(Δα) = sin(r) / cos(δ).
        let reach = if dec.abs() + radius >= FRAC_PI_2 { PI } else { (radius.sin() / dec.cos()).min(1.0).asin() };
        for band in to_band(dec - radius)..=to_band(dec + radius) {
            let (start, cells) = self.band(band);
            let width = TAU / cells as f64;
            let first = (wrap_two_pi(ra - reach) / width) as usize;
            let count = if reach >= PI { cells } else { ((2.0 * reach / width) as usize + 2).min(cells) };
            for step in 0..count {
                visit(start + (first + step) % cells);
            }
        }
    }

    /// Calls `visit` with every range of the sorted list that may hold a direction within `radius` rad of `centre`.
    pub fn ranges_near(&self, centre: &Vec3, radius: f64, mut visit: impl FnMut(Range<usize>)) {
        self.cells_near(centre, radius, |cell| visit(self.offsets[cell] as usize..self.offsets[cell + 1] as usize));
    }

    /// First cell and number of cells of a band.
    fn band(&self, band: usize) -> (usize, usize) {
        (self.first_cell[band] as usize, (self.first_cell[band + 1] - self.first_cell[band]) as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{DEG, direction, separation};

    #[test]
    fn every_direction_within_the_radius_is_visited() {
        // A spiral over the sphere, denser than the cells.
        let n = 20_000;
        let stars: Vec<Vec3> =
            (0..n).map(|i| direction(i as f64 * 2.399_963, ((i as f64 + 0.5) / n as f64 * 2.0 - 1.0).asin())).collect();
        let (grid, order) = SkyGrid::build(&stars, 1.3 * DEG, &mut Pace::new(&|| true)).unwrap();
        for (ra, dec, radius) in
            [(0.0, 0.0, 3.0), (359.9, 45.0, 2.0), (10.0, 89.5, 2.5), (200.0, -90.0, 1.0), (180.0, -60.0, 20.0)]
        {
            let centre = direction(ra * DEG, dec * DEG);
            let mut found = Vec::new();
            grid.ranges_near(&centre, radius * DEG, |range| found.extend_from_slice(&order[range]));
            let unique: std::collections::HashSet<u32> = found.iter().copied().collect();
            assert_eq!(unique.len(), found.len(), "nothing is visited twice");
            let wanted = (0..n).filter(|&i| separation(&stars[i], &centre) <= radius * DEG);
            assert!(wanted.into_iter().all(|i| unique.contains(&(i as u32))));
            assert!(found.len() < n / 2, "the search is local");
        }
    }
}
