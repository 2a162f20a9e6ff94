//! The catalogue as one camera sees it: moved to the epoch of observation, close pairs merged, ranked by local brightness.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: every index is made from the lists' own lengths")]

use super::cache::{DIRECTION_BYTES, FieldFileError, Loader, Saver, direction_bytes, is_direction, read_direction, sane};
use super::{Catalogue, FieldKey, Pace, SkyGrid};
use crate::sky::{ARCSEC, DEG, Vec3};
use std::io;

/// What the derivation from the catalogue depends on, besides the catalogue itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldGeometry {
    /// Diagonal of the field, rad.
    pub diagonal: f64,
    /// Area of the field that the stars are thinned for, sr.
    pub area: f64,
    /// Stars closer than this are one source, rad.
    pub blend: f64,
    /// Plate scale in the middle of its range, rad/px.
    pub platescale: f64,
}

/// Least area of a field, as a fraction of its diagonal squared: that of a frame of 2 : 1. A longer strip has fewer stars than
/// were wanted; with as many, triangles as long as the strip would fill any memory.
const LEAST_AREA: f64 = 0.4;
/// Smallest cell in which stars are merged and counted, rad: half a star of the catalogue. Smaller ones, of a tiny field, would be
/// empty and take hundreds of megabytes.
const LEAST_CELL: f64 = 0.2 * DEG;

impl FieldGeometry {
    /// The field of a camera of `width` × `height` px in the middle of its range of plate scales, arcsec/px.
    pub fn new(width: usize, height: usize, platescale_range: (f64, f64), blend_px: f64) -> Self {
        let platescale = 0.5 * (platescale_range.0 + platescale_range.1) * ARCSEC;
        let (w, h) = (width as f64 * platescale, height as f64 * platescale);
        let diagonal = w.hypot(h);
        let area = (w * h).max(LEAST_AREA * diagonal * diagonal);
        Self { diagonal, area, blend: blend_px * platescale, platescale }
    }
}

/// A star as the camera sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldStar {
    /// Unit vector, ICRS, at the epoch of the field.
    pub direction: Vec3,
    /// Magnitude, of the whole blend.
    pub mag: f32,
    /// Brighter stars near it, within the radius that the thinning takes; capped.
    pub rank: u8,
    /// Index of the (brightest) star in the catalogue.
    pub star: u32,
}

/// All stars as one camera sees them, sorted by cells of the sky.
#[derive(Debug, Clone)]
pub struct FieldStars {
    /// Epoch that the stars were moved to, Julian year.
    pub epoch_yr: f64,
    /// The stars, in the grid's order.
    pub stars: Vec<FieldStar>,
    grid: SkyGrid,
}

/// Radius inside which brighter stars are counted, as a fraction of the radius of the circle with the field's area; and the count,
/// as a fraction of the wanted stars per field, below which a star is kept (trials of thinning: this pair keeps what a camera
/// really sees as brightest).
const RANK_RADIUS: f64 = 0.73;
const RANK_PER_WANTED: f64 = 0.56;

/// The rank from which stars are left out, to have about `wanted` stars in a field.
pub fn rank_limit(wanted: f64) -> u8 {
    (RANK_PER_WANTED * wanted).round().clamp(1.0, f64::from(u8::MAX)) as u8
}

impl FieldStars {
    /// Derives the stars of a field from the catalogue; `None` where the pace ends it.
    pub fn build(catalogue: &Catalogue, key: &FieldKey, geometry: &FieldGeometry, pace: &mut Pace<'_>) -> Option<Self> {
        let years = key.epoch_yr - catalogue.header.epoch_yr;
        let mut directions = Vec::with_capacity(catalogue.stars.len());
        for star in &catalogue.stars {
            pace.step(1)?;
            directions.push(star.direction_after(years));
        }
        let mags: Vec<f32> = catalogue.stars.iter().map(|s| s.mag).collect();
        let mut stars = merge_blends(&directions, &mags, geometry.blend, pace)?;
        let radius = RANK_RADIUS * (geometry.area / std::f64::consts::PI).sqrt();
        count_brighter(&mut stars, radius, key.verification_rank(), pace)?;
        let directions: Vec<Vec3> = stars.iter().map(|s| s.direction).collect();
        let (grid, order) = SkyGrid::build(&directions, cell(geometry), pace)?;
        let mut sorted = Vec::with_capacity(stars.len());
        for &i in &order {
            pace.step(1)?;
            sorted.push(stars[i as usize]);
        }
        Some(Self { epoch_yr: key.epoch_yr, stars: sorted, grid })
    }

    /// Writes stars and grid.
    pub fn save(&self, saver: &mut Saver<'_>) -> io::Result<()> {
        saver.list(&self.stars, |star| {
            let mut bytes = [0; STAR_BYTES];
            let (direction, rest) = bytes.split_at_mut(DIRECTION_BYTES);
            direction.copy_from_slice(&direction_bytes(&star.direction));
            rest[..4].copy_from_slice(&star.mag.to_le_bytes());
            rest[4..8].copy_from_slice(&star.star.to_le_bytes());
            rest[8] = star.rank;
            bytes
        })?;
        self.grid.save(saver)
    }

    /// Reads stars and grid.
    pub fn load(loader: &mut Loader<'_>, key: &FieldKey, geometry: &FieldGeometry) -> Result<Self, FieldFileError> {
        let stars: Vec<FieldStar> = loader.list(|bytes: &[u8; STAR_BYTES]| {
            let [direction @ .., m0, m1, m2, m3, s0, s1, s2, s3, rank] = bytes;
            FieldStar {
                direction: read_direction(direction),
                mag: f32::from_le_bytes([*m0, *m1, *m2, *m3]),
                rank: *rank,
                star: u32::from_le_bytes([*s0, *s1, *s2, *s3]),
            }
        })?;
        sane(
            "stars",
            stars.iter().all(|star| is_direction(&star.direction) && star.mag.is_finite() && star.star < key.catalogue.1),
        )?;
        let grid = SkyGrid::load(loader, cell(geometry), stars.len())?;
        Ok(Self { epoch_yr: key.epoch_yr, stars, grid })
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.stars[..]) + self.grid.bytes()
    }

    /// Calls `visit` with the index of every star within `radius` rad of `centre`, and possibly a few more.
    pub fn near(&self, centre: &Vec3, radius: f64, mut visit: impl FnMut(usize, &FieldStar)) {
        let cos_radius = radius.cos();
        self.grid.ranges_near(centre, radius, |range| {
            for i in range {
                let star = &self.stars[i];
                if star.direction.dot(centre) >= cos_radius {
                    visit(i, star);
                }
            }
        });
    }
}

/// Bytes of a star in a file.
const STAR_BYTES: usize = DIRECTION_BYTES + 9;

/// Width of the cells that the stars of a field are sorted by, rad: a few cells cover a field.
fn cell(geometry: &FieldGeometry) -> f64 {
    0.2 * geometry.diagonal
}

/// Merges every star into a brighter one within `blend` rad: positions weighted by flux, magnitudes added as fluxes.
///
/// `directions` come brightest first, and so do the results.
fn merge_blends(directions: &[Vec3], mags: &[f32], blend: f64, pace: &mut Pace<'_>) -> Option<Vec<FieldStar>> {
    // A cell no smaller than the blend radius, so that few cells are looked at, and not so small that most are empty.
    let (grid, order) = SkyGrid::build(directions, blend.max(LEAST_CELL), pace)?;
    let cos_blend = blend.cos();
    let flux = |mag: f32| 10f64.powf(-0.4 * f64::from(mag));
    let mut absorbed = vec![false; directions.len()];
    let (mut single, mut blends) = (Vec::with_capacity(directions.len()), Vec::new());
    for (i, direction) in directions.iter().enumerate() {
        pace.step(1)?;
        if absorbed[i] {
            continue;
        }
        let mut sum = direction * flux(mags[i]);
        let mut total = flux(mags[i]);
        grid.ranges_near(direction, blend, |range| {
            for &j in &order[range] {
                let j = j as usize;
                if j > i && !absorbed[j] && directions[j].dot(direction) >= cos_blend {
                    absorbed[j] = true;
                    sum += directions[j] * flux(mags[j]);
                    total += flux(mags[j]);
                }
            }
        });
        let star = |mag: f32| FieldStar { direction: sum.normalize(), mag, rank: 0, star: i as u32 };
        if total > flux(mags[i]) {
            blends.push(star((-2.5 * total.log10()) as f32));
        } else {
            single.push(star(mags[i]));
        }
    }
    // The single ones are in order already.
    blends.sort_by(|a, b| a.mag.total_cmp(&b.mag));
    let mut blends = blends.into_iter().peekable();
    let mut merged = Vec::with_capacity(single.len() + blends.len());
    for star in single {
        pace.step(1)?;
        merged.extend(std::iter::from_fn(|| blends.next_if(|blend| blend.mag <= star.mag)));
        merged.push(star);
    }
    merged.extend(blends);
    Some(merged)
}

/// Counts, for each star (brightest first), the brighter ones within `radius` rad, up to `cap`.
///
/// A star that has reached the cap is not counted for others any more: those around it have reached it too, or nearly.
fn count_brighter(stars: &mut [FieldStar], radius: f64, cap: u8, pace: &mut Pace<'_>) -> Option<()> {
    let directions: Vec<Vec3> = stars.iter().map(|s| s.direction).collect();
    let (grid, _) = SkyGrid::build(&directions, (0.7 * radius).max(LEAST_CELL), pace)?;
    let cos_radius = radius.cos() as f32;
    // The counted stars of each cell, side by side in memory, and their number: a cell has room for all its stars.
    let mut counted = vec![[0f32; 3]; stars.len()];
    let mut counts = vec![0u32; grid.cells()];
    for (star, direction) in stars.iter_mut().zip(&directions) {
        pace.step(1)?;
        let mut count = 0u32;
        let [x, y, z] = [direction.x as f32, direction.y as f32, direction.z as f32];
        grid.cells_near(direction, radius, |cell| {
            if count < u32::from(cap) {
                let first = grid.first(cell);
                let counted = &counted[first..first + counts[cell] as usize];
                count += counted.iter().map(|o| u32::from(o[0] * x + o[1] * y + o[2] * z >= cos_radius)).sum::<u32>();
            }
        });
        star.rank = count.min(u32::from(cap)) as u8;
        if star.rank < cap {
            let cell = grid.cell_of(direction);
            counted[grid.first(cell) + counts[cell] as usize] = [x, y, z];
            counts[cell] += 1;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{direction, separation};

    #[test]
    fn a_close_pair_becomes_one_brighter_star_between_them() {
        let a = direction(1.0, 0.2);
        let b = direction(1.0, 0.2 + 10.0 * ARCSEC);
        let far = direction(1.0, 0.2 + 60.0 * ARCSEC);
        let merged = merge_blends(&[a, b, far], &[5.0, 5.0, 7.0], 28.0 * ARCSEC, &mut Pace::new(&|| true)).unwrap();
        assert_eq!(merged.len(), 2);
        assert!((merged[0].mag - (5.0 - 0.7526)).abs() < 1e-3);
        assert!((separation(&merged[0].direction, &a) / ARCSEC - 5.0).abs() < 1e-3);
        assert_eq!(merged[1].star, 2);
    }

    #[test]
    fn a_strip_is_thinned_as_a_frame_of_two_to_one() {
        let field = |width, height| FieldGeometry::new(width, height, (9.2, 9.7), 3.0);
        let in_px = |field: &FieldGeometry| field.area / field.platescale.powi(2);
        assert!((in_px(&field(1536, 1024)) - 1536.0 * 1024.0).abs() < 1e-6);
        assert!((in_px(&field(2000, 1000)) - 2e6).abs() < 1e-6);
        assert!((in_px(&field(3000, 3)) - 0.4 * 9_000_009.0).abs() < 1e-6);
    }

    #[test]
    fn the_rank_counts_brighter_neighbours_alone() {
        let mut stars: Vec<FieldStar> = [(0.0, 1.0), (0.5, 2.0), (0.9, 3.0), (5.0, 4.0)]
            .iter()
            .map(|&(ra, mag)| FieldStar { direction: direction(ra * DEG, 0.0), mag, rank: 0, star: 0 })
            .collect();
        count_brighter(&mut stars, 1.0 * DEG, 9, &mut Pace::new(&|| true)).unwrap();
        assert_eq!(stars.iter().map(|s| s.rank).collect::<Vec<_>>(), [0, 1, 2, 0]);
    }
}
