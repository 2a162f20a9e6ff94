//! The simulated sky: frames rendered from the catalogue, as a gondola sees them that scans in azimuth while the sky turns.

use super::{CameraError, Moment, Source};
use crate::catalog::Catalogue;
use crate::image::Series;
use crate::settings::{Settings, SimulateSettings};
use crate::simulate::sky::{Exposure, Kind, RenderSpec, Truth, UnknownKind, render_with};
use crate::sky::{ARCSEC, Attitude, DEG, Observer, RowOrder, precess_from_j2000, wrap_two_pi};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;
use std::time::Duration;

/// The exposure that rendered frames are made for, s: the program's that flew. Another one changes their light.
const NOMINAL_EXPOSURE_S: f64 = 0.12;

/// A gondola: where it stands and how it moves. All angles in rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gondola {
    /// The observer at the start; the sidereal time comes from the seed, so that another seed sees another sky.
    start: Observer,
    elevation: f64,
    scan_rate: f64,
    scan_amplitude: f64,
}

impl Gondola {
    /// The gondola that the settings describe.
    pub fn new(settings: &SimulateSettings) -> Self {
        // Multiples of the golden ratio spread seeds over the day evenly.
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        Self {
            start: Observer {
                latitude: settings.latitude_deg * DEG,
                sidereal_time: (settings.seed as f64 * GOLDEN).fract() * TAU,
            },
            elevation: settings.elevation_deg * DEG,
            scan_rate: settings.scan_rate_deg_s * DEG,
            scan_amplitude: settings.scan_amplitude_deg * DEG,
        }
    }

    /// Latitude, and sidereal time at a time after the start.
    pub fn observer(&self, uptime: Duration) -> Observer {
        self.start.after(uptime.as_secs_f64())
    }

    /// Azimuth: to and fro about North at the scan's rate.
    pub fn azimuth(&self, uptime: Duration) -> f64 {
        if self.scan_amplitude <= 0.0 {
            return 0.0;
        }
        let path = (self.scan_rate * uptime.as_secs_f64()).rem_euclid(4.0 * self.scan_amplitude);
        let swing = if path <= 2.0 * self.scan_amplitude { path } else { 4.0 * self.scan_amplitude - path };
        wrap_two_pi(swing - self.scan_amplitude)
    }

    /// The attitude of a camera whose up direction is towards the zenith. `julian_year`: the epoch of date that azimuth and
    /// elevation refer to; `None` takes sidereal time as that of ICRS.
    pub fn attitude(&self, uptime: Duration, julian_year: Option<f64>) -> Option<Attitude> {
        let observer = self.observer(uptime);
        let azimuth = self.azimuth(uptime);
        let to_icrs = |elevation: f64| {
            let of_date = observer.direction_of(azimuth, elevation);
            julian_year.map_or(of_date, |year| precess_from_j2000(year).tr_mul(&of_date))
        };
        Attitude::from_boresight_up(&to_icrs(self.elevation), &to_icrs(self.elevation + FRAC_PI_2))
    }
}

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

    /// What the last frame shows.
    pub fn truth(&self) -> Option<&Truth> {
        self.truth.as_ref()
    }

    /// The gondola that carries the camera.
    pub fn gondola(&self) -> &Gondola {
        &self.gondola
    }
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
        let year = moment.utc.map(|utc| utc.julian_year());
        let spec = RenderSpec {
            index: u64::from(moment.image.0),
            attitude: self.gondola.attitude(moment.uptime, year),
            epoch_yr: year.unwrap_or(self.spec.epoch_yr),
            disc_px: self.lens.as_ref().map(LensFocus::disc_px),
            light: self.exposure_s / NOMINAL_EXPOSURE_S,
            gain: 10_f64.powf(self.gain_db / 20.0),
            ..self.spec.clone()
        };
        let rendered = render_with(&spec, &self.catalogue, &mut self.exposure)
            .map_err(|error| CameraError::Unavailable(error.to_string()))?;
        let mut frame = rendered.frame;
        moment.date(0.0, &mut frame.stamp);
        frame.stamp.exposure_s = Some(self.exposure_s);
        frame.stamp.observer = Some(self.gondola.observer(moment.uptime));
        self.truth = Some(rendered.truth);
        Ok(frame.into())
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
    use crate::image::ImageCounter;
    use crate::sky::{ClockQuality, Utc, horizontal_of, separation};

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
    fn the_gondola_scans_within_its_limits_and_holds_its_elevation() {
        let settings = settings();
        let gondola = Gondola::new(&settings.simulate);
        let limit = settings.simulate.scan_amplitude_deg * DEG + 1e-9;
        let mut previous = gondola.azimuth(Duration::ZERO);
        for second in 1..600 {
            let uptime = Duration::from_secs(second);
            let azimuth = gondola.azimuth(uptime);
            let from_north = crate::sky::wrap_pi(azimuth);
            assert!(from_north.abs() <= limit, "{second} s: {}°", from_north / DEG);
            let moved = crate::sky::wrap_pi(azimuth - previous).abs();
            assert!(moved <= settings.simulate.scan_rate_deg_s * DEG + 1e-9);
            previous = azimuth;
            let attitude = gondola.attitude(uptime, Some(2027.0)).unwrap();
            let horizontal = horizontal_of(&attitude, &gondola.observer(uptime), Some(2027.0));
            assert!((horizontal.elevation - settings.simulate.elevation_deg * DEG).abs() < 1e-9);
            assert!(crate::sky::wrap_pi(horizontal.azimuth - azimuth).abs() < 1e-9);
            assert!(horizontal.roll.abs() < 1e-9);
        }
    }

    #[test]
    fn a_gondola_that_does_not_scan_sees_the_sky_turn() {
        let still = SimulateSettings { scan_amplitude_deg: 0.0, latitude_deg: 0.0, elevation_deg: 90.0, ..settings().simulate };
        let gondola = Gondola::new(&still);
        let [a, b] = [0, 3600].map(|s| gondola.attitude(Duration::from_secs(s), None).unwrap().boresight());
        assert!((separation(&a, &b) / DEG - 15.041).abs() < 1e-3);
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
