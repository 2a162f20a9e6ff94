//! Why a frame was not solved, by its own evidence: what spoils it, with a size where it has one.
//!
//! The solver collects the [`Evidence`]; what follows from it is decided here, without a look at the frame. What is shown beyond doubt
//! comes first: a pattern that other settings would have found, then what the whole frame shows of the sky, then the figure that its stars
//! are, then what there is instead of stars.

use super::Cause;
use crate::image::{CELL_PX, CellStatistics};
use crate::sources::Figure;

/// How large the images of stars are, where they are no points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur {
    /// Diameter of discs, or length of trails, px.
    pub size_px: f64,
    /// Direction of trails, from x towards y in file order, in [0, π), rad; `None` of discs.
    pub angle: Option<f64>,
}

/// What a frame that was not solved shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Evidence {
    /// A setting with which the sources would have fitted a pattern, in words.
    pub setting: Option<(Cause, String)>,
    /// Saturated pixels, fraction of the frame.
    pub saturated_fraction: f64,
    /// Typical distance of the values that there are from each other, ADU.
    pub step_adu: f64,
    /// The sky.
    pub sky: SkyEvidence,
    /// Sharp sources that are surely of a star's shape.
    pub stars: usize,
    /// The figure that stars are; none is looked for under clouds, which have figures of their own.
    pub figure: Option<Figure>,
}

/// What follows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Diagnosis {
    /// What was wrong.
    pub cause: Cause,
    /// In words, with numbers.
    pub detail: String,
    /// The size of the blur, where that was it.
    pub blur: Option<Blur>,
}

impl Diagnosis {
    fn new(cause: Cause, detail: String) -> Self {
        Self { cause, detail, blur: None }
    }
}

/// So much of the frame without any noise, or saturated, spoils it.
const FLAT_FRACTION: f64 = 0.1;
const SATURATED_FRACTION: f64 = 0.2;
/// Values this many σ apart hide the noise, and with it all that is faint. (Two values in turn have a σ of half their distance.)
const STEP_SIGMAS: f64 = 1.9;
/// The means of a covered sensor's cells spread as noise has it, and a little more for hot pixels; any sky spreads them further.
const DARK_SPREAD: f64 = 1.5;
/// Star-like sources that chance leaves on a sensor without light.
const DARK_STARS: usize = 5;
/// Share of the cells with a spike from which on artefacts, not stars, are what a frame is full of.
const CLUTTERED: f64 = 0.05;
/// A sky that bends this many times as much as its noise has clouds.
const CLOUDED: f64 = 10.0;
/// With fewer stars than this, nothing but that they are few is wrong with a frame; and so many a pattern needs.
const FEW_STARS: usize = 8;
const LEAST_STARS: usize = 5;

impl Evidence {
    /// The cause, where the evidence shows one.
    pub fn weigh(&self) -> Option<Diagnosis> {
        if let Some((cause, detail)) = &self.setting {
            return Some(Diagnosis::new(*cause, detail.clone()));
        }
        let sky = &self.sky;
        let percent = |fraction: f64| 100.0 * fraction;
        if sky.flat >= FLAT_FRACTION {
            return Some(Diagnosis::new(
                Cause::NoContrast,
                format!("{:.0} % of the frame has no noise at all", percent(sky.flat)),
            ));
        }
        if self.step_adu > STEP_SIGMAS * sky.noise {
            let detail = format!("values are {:.0} ADU apart, more than the noise of {:.1} ADU", self.step_adu, sky.noise);
            return Some(Diagnosis::new(Cause::NoContrast, detail));
        }
        if self.saturated_fraction >= SATURATED_FRACTION {
            let detail = format!("{:.0} % of the pixels are saturated", percent(self.saturated_fraction));
            return Some(Diagnosis::new(Cause::Saturated, detail));
        }
        if let Some(blurred) = self.figure.as_ref().and_then(|figure| blurred(figure, self.stars)) {
            return Some(blurred);
        }
        if sky.spread <= DARK_SPREAD && self.stars <= DARK_STARS {
            let detail = format!(
                "no light: the level is {:.0} ADU everywhere to {:.2} ADU, as the noise of {:.2} ADU has it",
                sky.level,
                sky.spread * sky.noise / CELL_PX as f64,
                sky.noise
            );
            return Some(Diagnosis::new(Cause::LensCovered, detail));
        }
        if sky.spiky >= CLUTTERED {
            let detail = format!(
                "{:.0} % of the cells have a spike in them, and {} sources look like stars",
                percent(sky.spiky),
                self.stars
            );
            return Some(Diagnosis::new(Cause::TooManyArtefacts, detail));
        }
        if sky.is_clouded() {
            let detail = format!(
                "the sky of {:.0} ADU goes up and down by {:.0} ADU over 50 to 200 px, {:.0} times as much as its noise",
                sky.level,
                sky.structure,
                sky.structure / sky.structure_noise.max(f64::MIN_POSITIVE)
            );
            return Some(Diagnosis::new(Cause::Clouds, detail));
        }
        (self.stars < FEW_STARS)
            .then(|| Diagnosis::new(Cause::TooFewStars, format!("{} sources look like stars beyond doubt", self.stars)))
    }

    /// Whether the stars, if that is what they are, are worth a second look: on a clear sky as few as make a pattern, else as many bright
    /// ones as artefacts hardly are.
    pub fn is_starry(&self, bright: usize) -> bool {
        let clear = !self.sky.is_clouded() && self.sky.spiky < CLUTTERED;
        self.stars >= LEAST_STARS && clear || bright >= FEW_STARS
    }
}

/// Noise of a figure's autocorrelation with which it is clear, and with which it still can be told where several stand out.
const CLEAR_NOISE: f64 = 0.12;
const FAINT_NOISE: f64 = 0.22;
/// What a figure must stand out by if nothing else in the frame is like it, or if it is faint: noise alone reaches 6.
const LONE_SNR: f64 = 6.5;
const FAINT_SNR: f64 = 7.0;
/// A figure narrower than this is no disc, and no unbroken trail, px.
const POINT_PX: f64 = 3.0;
/// A trail is so many times as long as wide, by half widths and by its reach; one of points by its reach alone, px, and where several are there.
const TRAIL_LONG: f64 = 2.0;
const TRAIL_REACH: f64 = 4.0;
const SHORTEST_TRAIL_PX: f64 = 12.0;
/// Beyond this the end of a trail is not seen: it may be a satellite's, px.
const LONGEST_TRAIL_PX: f64 = 110.0;
/// A disc's autocorrelation ends between these parts of the lag at which it falls to half: what falls off otherwise is glow or cloud.
const DISC_END: (f64, f64) = (1.1, 2.3);
/// Sharp sources that chance leaves among discs.
const SHARP_AMID_DISCS: usize = 2;
/// A disc is round.
const DISC_LONG: f64 = 1.45;

/// The diagnosis of a figure that is no point.
fn blurred(figure: &Figure, stars: usize) -> Option<Diagnosis> {
    let several = figure.alike >= 2;
    let clear = figure.noise <= CLEAR_NOISE && (several && 3 * figure.alike >= figure.count || figure.snr >= LONE_SNR);
    let faint = figure.noise <= FAINT_NOISE && several && 2 * figure.alike >= figure.count && figure.snr >= FAINT_SNR;
    if !clear && !faint {
        return None;
    }
    let (long, short) = (figure.long_px, figure.short_px);
    let trail = if figure.is_narrow() {
        figure.row_px >= SHORTEST_TRAIL_PX.max(TRAIL_REACH * short)
    } else {
        long >= TRAIL_LONG * short && figure.end_px >= TRAIL_REACH * short
    };
    let (size_px, angle) = figure.trail();
    if trail && size_px <= LONGEST_TRAIL_PX {
        let detail = format!("stars are trailed by about {size_px:.0} px at {:.0}°", angle.to_degrees());
        return Some(Diagnosis { blur: Some(Blur { size_px, angle: Some(angle) }), ..Diagnosis::new(Cause::Trailed, detail) });
    }
    let half = figure.mean_px;
    let disc = stars <= SHARP_AMID_DISCS
        && half > POINT_PX
        && figure.elongation < DISC_LONG
        && (DISC_END.0 * half..DISC_END.1 * half).contains(&figure.end_px);
    disc.then(|| {
        let size_px = figure.disc_px();
        let detail = format!("stars are discs of about {size_px:.0} px across");
        Diagnosis { blur: Some(Blur { size_px, angle: None }), ..Diagnosis::new(Cause::OutOfFocus, detail) }
    })
}

/// What the cells show of the sky.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct SkyEvidence {
    /// Median of the cells' means, ADU.
    pub level: f64,
    /// Noise of a pixel, ADU.
    pub noise: f64,
    /// Cells without noise, fraction.
    pub flat: f64,
    /// Spread of the cells' means over what noise alone gives them.
    pub spread: f64,
    /// Bend of the sky over 50 to 200 px, ADU, and what noise alone gives it.
    pub structure: f64,
    /// As above.
    pub structure_noise: f64,
    /// Cells with a pixel far above all noise, fraction.
    pub spiky: f64,
}

/// σ of a normal distribution over its median absolute deviation.
const SIGMA_PER_DEVIATION: f64 = 1.482_6;
/// A pixel this far above its cell's mean is a spike: of the noise, and of the spread of the cell's pixels.
const SPIKE_SIGMAS: f64 = 8.0;
const SPIKE_SPREADS: f64 = 5.5;
/// Distances over which the sky's bend is looked at, cells.
const BEND_CELLS: [usize; 3] = [3, 6, 12];

impl SkyEvidence {
    /// What the cells show.
    pub fn of(cells: &CellStatistics) -> Self {
        let count = cells.mean.len().max(1) as f64;
        let mut noises: Vec<f64> =
            (0..cells.rows).flat_map(|row| cells.noise_row(row * CELL_PX)).map(|&noise| f64::from(noise)).collect();
        let flat = noises.iter().filter(|noise| **noise <= 0.0).count() as f64 / count;
        let mut means: Vec<f64> = cells.mean.iter().map(|&mean| f64::from(mean)).collect();
        let (Some(noise), Some(level)) = (median(&mut noises), median(&mut means)) else { return Self::default() };
        // Of the mean of a cell's pixels.
        let noise_of_mean = noise / CELL_PX as f64;
        means.iter_mut().for_each(|mean| *mean = (*mean - level).abs());
        let spread = SIGMA_PER_DEVIATION * median(&mut means).unwrap_or(0.0) / noise_of_mean.max(f64::MIN_POSITIVE);
        let structure = BEND_CELLS.iter().filter_map(|&distance| bend(cells, distance)).fold(0.0, f64::max);
        // Twice the middle less both ends.
        let structure_noise = 6f64.sqrt() * noise_of_mean;
        // Above the noise, and above what a slope spreads the cell's own pixels by.
        let is_spiky = |((max, mean), sigma): &((&u16, &f32), &f32)| {
            let height = f64::from(**max) - f64::from(**mean);
            height > SPIKE_SIGMAS * noise && height > SPIKE_SPREADS * f64::from(**sigma)
        };
        let spiky = cells.max.iter().zip(&cells.mean).zip(&cells.sigma).filter(is_spiky).count() as f64 / count;
        Self { level, noise, flat, spread, structure, structure_noise, spiky }
    }

    /// Whether the sky goes up and down as only clouds make it.
    pub fn is_clouded(&self) -> bool {
        self.structure > CLOUDED * self.structure_noise
    }
}

/// Typical bend of the sky over a distance, cells: the middle less the mean of both ends, twice; ADU.
fn bend(cells: &CellStatistics, distance: usize) -> Option<f64> {
    // As bits, which numbers that are not negative have in their order: these compare sooner.
    let mut bends: Vec<u32> = Vec::with_capacity(2 * cells.mean.len());
    let apart = |before: &[f32], here: &[f32], after: &[f32], bends: &mut Vec<u32>| {
        let ends = before.iter().zip(after);
        bends.extend(here.iter().zip(ends).map(|(here, (before, after))| (2.0 * here - before - after).abs().to_bits()));
    };
    for row in cells.mean.chunks_exact(cells.columns.max(1)) {
        apart(row, row.get(distance..).unwrap_or_default(), row.get(2 * distance..).unwrap_or_default(), &mut bends);
    }
    let below = distance * cells.columns;
    let after = |cells_on: usize| cells.mean.get(cells_on..).unwrap_or_default();
    apart(&cells.mean, after(below), after(2 * below), &mut bends);
    let middle = bends.len() / 2;
    (!bends.is_empty()).then(|| SIGMA_PER_DEVIATION * f64::from(f32::from_bits(*bends.select_nth_unstable(middle).1)))
}

fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A clear sky with stars enough: nothing is wrong with it.
    fn clear() -> Evidence {
        let sky = SkyEvidence {
            level: 1500.0,
            noise: 8.0,
            spread: 40.0,
            structure: 1.2,
            structure_noise: 1.2,
            ..SkyEvidence::default()
        };
        Evidence { sky, stars: 12, step_adu: 1.0, ..Evidence::default() }
    }

    /// The figure of points.
    fn points() -> Figure {
        Figure {
            count: 8,
            alike: 8,
            snr: 20.0,
            long_px: 2.4,
            short_px: 2.2,
            mean_px: 2.3,
            elongation: 1.1,
            end_px: 4.0,
            reach_px: 3.5,
            row_px: 3.5,
            long_angle: 0.0,
            reach_angle: 0.0,
            row_angle: 0.0,
            noise: 0.03,
            bin_px: 2.0,
        }
    }

    /// The figure of discs of 50 px.
    fn discs() -> Figure {
        Figure { long_px: 24.0, short_px: 23.0, mean_px: 23.4, end_px: 40.0, reach_px: 42.0, bin_px: 8.0, ..points() }
    }

    /// The figure of trails of 60 px.
    fn trails() -> Figure {
        Figure {
            long_px: 30.0,
            short_px: 5.0,
            mean_px: 10.0,
            elongation: 4.0,
            reach_px: 54.0,
            long_angle: 1.0,
            end_px: 52.0,
            bin_px: 8.0,
            ..points()
        }
    }

    fn cause_of(evidence: &Evidence) -> Option<Cause> {
        evidence.weigh().map(|diagnosis| diagnosis.cause)
    }

    #[test]
    fn nothing_is_said_of_a_clear_sky_with_sharp_stars() {
        assert_eq!(cause_of(&clear()), None);
        assert_eq!(cause_of(&Evidence { figure: Some(points()), ..clear() }), None);
    }

    #[test]
    fn each_cause_follows_from_one_thing_that_is_other() {
        let sky = clear().sky;
        let with_sky = |change: fn(&mut SkyEvidence)| {
            let mut sky = sky;
            change(&mut sky);
            Evidence { sky, ..clear() }
        };
        for (evidence, cause) in [
            (Evidence { setting: Some((Cause::Mirrored, String::new())), ..clear() }, Cause::Mirrored),
            (Evidence { saturated_fraction: 0.5, ..clear() }, Cause::Saturated),
            (Evidence { step_adu: 16.0, ..clear() }, Cause::NoContrast),
            (Evidence { stars: 3, ..clear() }, Cause::TooFewStars),
            (Evidence { figure: Some(discs()), stars: 1, ..clear() }, Cause::OutOfFocus),
            (Evidence { figure: Some(trails()), ..clear() }, Cause::Trailed),
            (with_sky(|sky| sky.flat = 0.5), Cause::NoContrast),
            (with_sky(|sky| sky.spiky = 0.2), Cause::TooManyArtefacts),
            (with_sky(|sky| sky.structure = 60.0), Cause::Clouds),
            (Evidence { stars: 1, ..with_sky(|sky| sky.spread = 1.0) }, Cause::LensCovered),
        ] {
            assert_eq!(cause_of(&evidence), Some(cause), "{evidence:?}");
        }
    }

    #[test]
    fn a_blur_has_its_size_and_says_it() {
        let blur = |figure: Figure| {
            let diagnosis = blurred(&figure, 0).unwrap();
            (diagnosis.blur.unwrap(), diagnosis.detail)
        };
        let (disc, detail) = blur(discs());
        assert!((disc.size_px - 50.0).abs() < 1.0 && disc.angle.is_none(), "{disc:?}");
        assert_eq!(detail, "stars are discs of about 50 px across");
        let (trail, detail) = blur(trails());
        assert!((trail.size_px - 60.0).abs() < 1.0 && trail.angle == Some(1.0), "{trail:?}");
        assert_eq!(detail, "stars are trailed by about 60 px at 57°");
        // A row of points: narrow, and as long as it reaches.
        let (row, _) = blur(Figure { row_px: 46.0, row_angle: 0.5, ..points() });
        assert!((row.size_px - 46.0).abs() < 1.0 && row.angle == Some(0.5), "{row:?}");
    }

    #[test]
    fn what_cannot_be_told_from_noise_is_no_blur() {
        for figure in [discs(), trails()] {
            assert!(blurred(&Figure { noise: 0.3, ..figure }, 0).is_none());
            assert!(blurred(&Figure { alike: 1, snr: 6.0, ..figure }, 0).is_none());
        }
        // A satellite, a chance row of two stars, a glow, and discs amid sharp stars.
        assert!(blurred(&Figure { long_px: 96.0, reach_px: 96.0, ..trails() }, 0).is_none());
        assert!(blurred(&Figure { reach_px: 46.0, count: 2, ..points() }, 0).is_none());
        assert!(blurred(&Figure { end_px: 90.0, ..discs() }, 0).is_none());
        assert!(blurred(&discs(), 9).is_none());
    }

    #[test]
    fn a_second_look_is_for_stars_alone() {
        assert!(clear().is_starry(0) && !Evidence { stars: 4, ..clear() }.is_starry(0));
        let clouded = Evidence { sky: SkyEvidence { structure: 60.0, ..clear().sky }, stars: 40, ..clear() };
        assert!(!clouded.is_starry(3) && clouded.is_starry(8));
    }

    #[test]
    fn a_frame_without_cells_shows_nothing_and_breaks_nothing() {
        assert_eq!(SkyEvidence::of(&CellStatistics::default()), SkyEvidence::default());
        assert!(Evidence::default().weigh().is_some());
    }
}
