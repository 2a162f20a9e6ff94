//! The simulated sky: frames rendered from the catalogue, as a gondola sees them that scans in azimuth while the sky turns.

use super::gondola::{Gondola, exposures_of_a_series};
use super::{CameraError, Moment, Source};
use crate::catalog::Catalogue;
use crate::image::{Frame, ImageCounter, Series};
use crate::settings::Settings;
use crate::simulate::sky::{Exposure, Kind, Part, RenderSpec, Truth, UnknownKind, render_with};
use crate::sky::{ARCSEC, Attitude, RowOrder, Vec3};
use crate::solve::Motion;
use std::sync::Arc;
use std::time::Duration;

/// The exposure that rendered frames are made for, s: the program's that flew. Another one changes their light.
const NOMINAL_EXPOSURE_S: f64 = 0.12;
/// Length of a step along the trails of a series, s: at the scan's usual rate a third of a pixel.
const STEP_S: f64 = 0.004;

/// The camera that looks at the simulated sky. Everything from it is stamped as simulated.
pub struct SimulatedSky {
    catalogue: Arc<Catalogue>,
    gondola: Gondola,
    spec: RenderSpec,
    exposure: Exposure,
    truth: Option<Truth>,
    lens: Option<LensFocus>,
    /// Gain, dB, and the time of one exposure, s.
    gain_db: f64,
    exposure_s: f64,
    /// It is asked for the exposures of a series one by one.
    one_by_one: bool,
    /// The last of them: its image, and its place there.
    last: Option<(ImageCounter, u8)>,
}

/// Where a simulated lens truly is, counts, and what follows for the stars.
struct LensFocus {
    position: Box<dyn Fn() -> f64 + Send>,
    best_counts: f64,
    blur_px_per_count: f64,
}

impl SimulatedSky {
    /// A sky by the settings, rendered from a catalogue.
    ///
    /// # Errors
    /// Where `simulate.kind` is no kind of frame.
    pub fn new(settings: &Settings, catalogue: Arc<Catalogue>) -> Result<Self, UnknownKind> {
        let matching = &settings.solver.matching;
        let kind: Kind = settings.simulate.kind.parse()?;
        let spec = RenderSpec {
            width: settings.camera.width_px as usize,
            height: settings.camera.height_px as usize,
            platescale: (matching.platescale_min_arcsec_px * ARCSEC, matching.platescale_max_arcsec_px * ARCSEC),
            epoch_yr: settings.catalog.epoch_yr,
            rows: RowOrder::BottomFirst,
            mirrored: settings.camera.mirrored,
            camera: Some(settings.simulate.seed),
            photon_bound: false,
            ..RenderSpec::new(kind, settings.simulate.seed, 0)
        };
        Ok(Self {
            catalogue,
            gondola: Gondola::new(&settings.simulate),
            spec,
            exposure: Exposure::default(),
            truth: None,
            lens: None,
            gain_db: settings.camera.gain_db,
            exposure_s: settings.camera.exposure_s,
            one_by_one: settings.camera.series_exposures > 1,
            last: None,
        })
    }

    /// Behind a lens whose focus is at what `position` says, counts: away from `simulate.best_focus_counts` stars become discs. Frames
    /// whose kind has a defocus of its own keep that.
    #[must_use]
    pub fn behind(mut self, settings: &Settings, position: impl Fn() -> f64 + Send + 'static) -> Self {
        if !matches!(self.spec.kind, Kind::Defocus | Kind::Defocus30) {
            self.lens = Some(LensFocus {
                position: Box::new(position),
                best_counts: f64::from(settings.simulate.best_focus_counts),
                blur_px_per_count: settings.focus.blur_px_per_count,
            });
        }
        self
    }

    /// The same under a gondola that was under way for so long before.
    #[must_use]
    pub fn after(mut self, flown: Duration) -> Self {
        self.gondola = self.gondola.after(flown);
        self
    }

    /// So many exposures of one series, during which the gondola goes on scanning, and how gyros without noise see that. The truth is that
    /// of the middle of their light.
    ///
    /// # Errors
    /// As [`Source::next`].
    pub fn series(&mut self, moment: &Moment, count: u8) -> Result<(Series, Motion), CameraError> {
        let exposures = exposures_of_a_series(count, self.exposure_s);
        let trails: Vec<Vec<Attitude>> = exposures.iter().map(|(start, _)| self.trail(moment, *start)).collect();
        let middle = middle(&trails)?;
        let mut frames = Vec::with_capacity(trails.len());
        for ((place, trail), (start, _)) in (0..).zip(&trails).zip(&exposures) {
            frames.push(self.part(moment, place, middle, trail, *start)?);
        }
        let series = Series::new(frames).map_err(|error| CameraError::Unavailable(error.to_string()))?;
        Ok((series, self.gondola.motion(moment.uptime, &exposures)))
    }

    /// How the camera turns during an exposure that begins so long after the moment, s.
    fn trail(&self, moment: &Moment, start_s: f64) -> Vec<Attitude> {
        let year = moment.utc.map(|utc| utc.julian_year());
        let steps = (self.exposure_s / STEP_S).ceil().max(1.0) as u32;
        let since = |step: u32| start_s + self.exposure_s * (f64::from(step) + 0.5) / f64::from(steps);
        let seen = |step: u32| self.gondola.attitude(moment.uptime + Duration::from_secs_f64(since(step)), year);
        (0..steps).filter_map(seen).collect()
    }

    /// One exposure of a series, by its trail about an attitude.
    fn part(
        &mut self,
        moment: &Moment,
        place: u8,
        about: Attitude,
        trail: &[Attitude],
        start_s: f64,
    ) -> Result<Frame, CameraError> {
        let turns = trail.iter().map(|attitude| about.turn_to(attitude)).collect();
        let part = Part { place, turns, starlight: 1.0, most_flux_adu: f64::INFINITY };
        self.expose(moment, Some(about), Some(part), start_s + 0.5 * self.exposure_s)
    }

    /// A frame, or one exposure of a series, with its middle so long after the moment, s.
    fn expose(
        &mut self,
        moment: &Moment,
        attitude: Option<Attitude>,
        part: Option<Part>,
        middle_s: f64,
    ) -> Result<Frame, CameraError> {
        let year = moment.utc.map(|utc| utc.julian_year());
        let spec = RenderSpec {
            index: u64::from(moment.image.0),
            attitude,
            epoch_yr: year.unwrap_or(self.spec.epoch_yr),
            disc_px: self.lens.as_ref().map(LensFocus::disc_px),
            part,
            light: self.exposure_s / NOMINAL_EXPOSURE_S,
            gain: 10_f64.powf(self.gain_db / 20.0),
            ..self.spec.clone()
        };
        let rendered = render_with(&spec, &self.catalogue, &mut self.exposure)
            .map_err(|error| CameraError::Unavailable(error.to_string()))?;
        let mut frame = rendered.frame;
        moment.date(middle_s, &mut frame.stamp);
        frame.stamp.exposure_s = Some(self.exposure_s);
        frame.stamp.observer = Some(self.gondola.observer(moment.uptime + Duration::from_secs_f64(middle_s)));
        self.truth = Some(rendered.truth);
        Ok(frame)
    }

    /// What the last frame shows.
    pub fn truth(&self) -> Option<&Truth> {
        self.truth.as_ref()
    }

    /// The gondola that carries the camera.
    pub fn gondola(&self) -> &Gondola {
        &self.gondola
    }
}

/// The middle of all attitudes of some trails.
fn middle(trails: &[Vec<Attitude>]) -> Result<Attitude, CameraError> {
    let all = || trails.iter().flatten();
    let first = *all().next().ok_or_else(|| CameraError::Unavailable("the gondola looks nowhere".to_owned()))?;
    Ok(first.turned(&(all().map(|other| first.turn_to(other)).sum::<Vec3>() / all().count() as f64)))
}

impl LensFocus {
    /// Diameter of the stars' discs, px: no more than the renderer makes.
    fn disc_px(&self) -> f64 {
        const LARGEST_PX: f64 = 33.0;
        (((self.position)() - self.best_counts).abs() * self.blur_px_per_count).min(LARGEST_PX)
    }
}

impl Source for SimulatedSky {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        if self.one_by_one {
            // Another exposure of the same image has another noise.
            let place = self.last.filter(|(image, _)| *image == moment.image).map_or(0, |(_, place)| place.wrapping_add(1));
            self.last = Some((moment.image, place));
            let trail = self.trail(moment, 0.0);
            let about = middle(std::slice::from_ref(&trail))?;
            return Ok(self.part(moment, place, about, &trail, 0.0)?.into());
        }
        let year = moment.utc.map(|utc| utc.julian_year());
        let attitude = self.gondola.attitude(moment.uptime, year);
        Ok(self.expose(moment, attitude, None, 0.0)?.into())
    }

    fn gain(&mut self) -> Result<f64, CameraError> {
        Ok(self.gain_db)
    }

    fn set_gain(&mut self, gain_db: f64) -> Result<(), CameraError> {
        self.gain_db = gain_db;
        Ok(())
    }

    fn exposure(&mut self) -> Result<f64, CameraError> {
        Ok(self.exposure_s)
    }

    fn set_exposure(&mut self, exposure_s: f64) -> Result<(), CameraError> {
        self.exposure_s = exposure_s;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Ask;
    use crate::sky::{ClockQuality, Utc, separation};

    fn settings() -> Settings {
        Settings::flight().unwrap()
    }

    fn moment(image: u32, seconds: u64) -> Moment {
        Moment {
            image: ImageCounter(image),
            uptime: Duration::from_secs(seconds),
            utc: Utc::from_calendar(2026, 12, 30, 8, 0, seconds as f64),
            quality: ClockQuality::FreeRunning,
            sigma_s: None,
            ask: Ask::Expose,
        }
    }

    #[test]
    fn exposure_and_gain_change_the_light_its_noise_and_the_stamp() {
        let mut small = settings();
        (small.camera.width_px, small.camera.height_px) = (256, 192);
        let mut sky = SimulatedSky::new(&small, Arc::new(Catalogue::embedded().unwrap())).unwrap();
        let mut seen = |exposure_s: f64, gain_db: f64| {
            sky.set_exposure(exposure_s).unwrap();
            sky.set_gain(gain_db).unwrap();
            assert_eq!((sky.exposure(), sky.gain()), (Ok(exposure_s), Ok(gain_db)));
            let frame = sky.next(&moment(7, 40)).unwrap().exposures()[0].clone();
            assert_eq!(frame.stamp.exposure_s, Some(exposure_s));
            let mut cells = crate::image::CellStatistics::default();
            cells.measure(&frame, None);
            // Over the bias of 100 ADU that the rendered camera has.
            (cells.image_mean - 100.0, cells.image_noise)
        };
        let (mean, noise) = seen(0.12, 0.0);
        let (twice, noise_of_twice) = seen(0.24, 0.0);
        assert!((twice / mean - 2.0).abs() < 0.02, "{twice} ADU in twice the time, {mean} before");
        assert!((1.2..1.9).contains(&(noise_of_twice / noise)), "its noise grows as photons' does: {noise_of_twice} of {noise}");
        let (gained, noise_of_gained) = seen(0.12, 6.0);
        assert!(
            (gained / mean - 1.995).abs() < 0.02 && (noise_of_gained / noise - 1.995).abs() < 0.1,
            "{gained}, {noise_of_gained}"
        );
    }

    #[test]
    fn frames_are_simulated_stamped_and_show_what_the_truth_says() {
        let mut small = settings();
        (small.camera.width_px, small.camera.height_px) = (256, 192);
        let mut sky = SimulatedSky::new(&small, Arc::new(Catalogue::embedded().unwrap())).unwrap();
        let frame = sky.next(&moment(7, 40)).unwrap().exposures()[0].clone();
        assert!(frame.stamp.simulated);
        assert_eq!((frame.width, frame.height), (256, 192));
        assert_eq!(frame.stamp.captured.map(|(utc, _)| utc), moment(7, 40).utc);
        let truth = sky.truth().unwrap();
        assert_eq!(truth.index, 7);
        let year = moment(7, 40).utc.unwrap().julian_year();
        let wanted = sky.gondola().attitude(Duration::from_secs(40), Some(year)).unwrap();
        assert!(separation(&truth.attitude.unwrap().boresight(), &wanted.boresight()) < 1e-9);
        let again = sky.next(&moment(7, 40)).unwrap();
        assert_eq!(again.exposures(), [frame], "the same moment shows the same frame");
    }
}
