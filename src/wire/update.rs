//! `Update`: everything that a flight computer is told, twice a second.

use super::clocks::Clocks;
use super::commands::Control;
use super::element::body;
use super::health::Health;
use super::instrument::{Focus, Lens};
use super::series::Series;
use super::status::ObserverPart;
use super::times::Times;
use super::triggers::Triggers;
use super::{Coded, I32Le, List, Maybe, Text, U16Le, U32Le};
use crate::command::Refusal;
use crate::sky::{ClockQuality, Utc};
use crate::solve::{Cause, Reason, SearchMode};

body! {
    /// Everything that the camera tells a flight computer, every 0.5 s on a steady schedule.
    pub struct Update {
        /// The connection and the camera's own state.
        link: Link => "";
        /// Who may command, and what came of it.
        authority: Authority => "";
        /// What the service did since its start.
        counters: Counters => "";
        /// Temperatures, pressure and disk.
        housekeeping: Housekeeping => "";
        /// Camera and lens as they are now.
        camera: Camera => "";
        /// The last image that ended in an outcome.
        image: Maybe<Image> => "";
        /// What became of commands. From version 2 on.
        control: Control => "";
        /// What is known of the lens besides where it is. From version 2 on.
        lens: Lens => "";
        /// The autofocus. From version 2 on.
        focus: Focus => "";
        /// Ages and limits of the housekeeping's values, restarts and their reasons. From version 2 on.
        health: Health => "";
        /// The series of exposures that the last image is made of. From version 3 on.
        series: Maybe<Series> => "";
        /// How the flight computers' clocks stand against the camera's. From version 3 on.
        clocks: Clocks => "";
        /// What makes the camera expose. From version 3 on.
        triggers: Triggers => "";
        /// How well times are known. From version 3 on.
        times: Times => "";
    }
}

body! {
    /// A clock that may be wrong.
    pub struct Clock {
        /// UTC when this message was made, seconds since 1970.
        clock_unix_s: Maybe<f64> => "s" [0.0, 1e11];
        /// How far that clock can be believed.
        clock_quality: Coded<ClockQuality> => "";
    }
}

body! {
    /// The connection and the camera's own state.
    pub struct Link {
        /// Counts the updates of this connection, from 0.
        sequence: U32Le => "";
        /// Number drawn at random at the camera's start: another one means that it started anew.
        boot_id: U32Le => "";
        /// Time since the camera program's start, from a clock that never jumps.
        uptime_s: f64 => "s" [0.0, 1e10];
        /// The camera computer's clock.
        clock: Clock => "";
        /// CRC-32 of the settings in force.
        settings_hash: U32Le => "";
        /// Images do not come from a real camera.
        simulated_camera: bool => "";
        /// The lens is not a real one.
        simulated_lens: bool => "";
        /// Statuses received from this flight computer on this connection.
        statuses_received: U32Le => "";
        /// Sequence number of the last status received on this connection.
        last_status_sequence: Maybe<U32Le> => "";
        /// Age of that status.
        last_status_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Values in this connection's statuses that were out of range and taken as not known.
        status_values_withheld: U32Le => "";
    }
}

body! {
    /// Who may command, and what came of it.
    pub struct Authority {
        /// The flight computer in charge, by the `id` of its hello.
        in_charge_id: Maybe<u8> => "" [1.0, 255.0];
        /// Uptime of the camera at which it came to be in charge.
        in_charge_since_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Whether the receiver of this update is in charge.
        you_are_in_charge: bool => "";
        /// How many connected flight computers claim to be in charge.
        claims: u8 => "";
        /// Commands accepted since the camera's start.
        commands_accepted: U32Le => "";
        /// Commands refused since the camera's start.
        commands_refused: U32Le => "";
        /// Why the last one was refused.
        last_refusal: Maybe<Coded<Refusal>> => "";
    }
}

body! {
    /// What the service did since its start.
    pub struct Counters {
        /// Frames that the camera gave.
        frames_taken: U32Le => "";
        /// Frames solved.
        frames_solved: U32Le => "";
        /// Frames replaced by a newer one before their turn.
        frames_skipped: U32Le => "";
        /// Frames or records that should have been kept and were not.
        frames_lost: U32Le => "";
        /// Times that the camera's actor was started again.
        restarts_camera: U32Le => "";
        /// Times that the solver's actor was started again.
        restarts_solver: U32Le => "";
        /// Times that the hub was started again.
        restarts_hub: U32Le => "";
        /// Times that the recorder was started again.
        restarts_recorder: U32Le => "";
        /// Times that the server for flight computers, or a session in it, was started again after it broke.
        restarts_server: U32Le => "";
        /// Connections closed because of what the other end sent.
        links_refused: U32Le => "";
        /// A frame is being solved.
        solving: bool => "";
    }
}

body! {
    /// Temperatures, pressure and disk.
    pub struct Housekeeping {
        /// Temperature of the lens.
        temperature_lens_c: Maybe<f64> => "°C" [-273.15, 1000.0];
        /// Temperature of the computer.
        temperature_computer_c: Maybe<f64> => "°C" [-273.15, 1000.0];
        /// Temperature of the vessel.
        temperature_vessel_c: Maybe<f64> => "°C" [-273.15, 1000.0];
        /// Temperature of the plate.
        temperature_plate_c: Maybe<f64> => "°C" [-273.15, 1000.0];
        /// Temperature of the DC-DC converter.
        temperature_dcdc_c: Maybe<f64> => "°C" [-273.15, 1000.0];
        /// Temperature of the flange.
        temperature_flange_c: Maybe<f64> => "°C" [-273.15, 1000.0];
        /// Pressure in the vessel.
        pressure_atm: Maybe<f64> => "atm" [0.0, 100.0];
        /// Free space on the disk that records go to, in units of 2^30 bytes.
        disk_free_gib: Maybe<f64> => "GiB" [0.0, 1e9];
    }
}

body! {
    /// Camera and lens as they are now.
    pub struct Camera {
        /// Number that the next image will receive.
        next_image_counter: U32Le => "";
        /// Gain; known only while no change of it is under way.
        gain_db: Maybe<f64> => "dB" [-100.0, 1000.0];
        /// Focus position, encoder counts; known only while no change of it is under way.
        focus_counts: Maybe<I32Le> => "counts";
        /// Aperture position, 0 is fully open; known only while no change of it is under way.
        aperture_counts: Maybe<I32Le> => "counts";
    }
}

body! {
    /// The last image that ended in an outcome.
    pub struct Image {
        /// The camera's number of the image.
        image_counter: U32Le => "";
        /// The flight computer's number of the series of triggers that the image belongs to.
        image_trigger_counter: Maybe<U32Le> => "";
        /// Exposures co-added into the image.
        exposures: u8 => "";
        /// Exposure time of one exposure.
        exposure_s: Maybe<f64> => "s" [0.0, 1e6];
        /// Middle of the exposure, UTC, seconds since 1970.
        captured_unix_s: Maybe<f64> => "s" [0.0, 1e11];
        /// How far the clock that stamped it could be believed.
        captured_quality: Maybe<Coded<ClockQuality>> => "";
        /// Time from the capture to this update, from a clock that never jumps.
        image_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// How the image ended.
        reason: Coded<Reason> => "";
        /// What the image's own evidence says was wrong.
        cause: Maybe<Coded<Cause>> => "";
        /// The reason in words, cut where it is longer.
        detail: Text<120> => "";
        /// How sources were searched for. Before version 3 along a motion is told as robust.
        mode: Coded<SearchMode> => "";
        /// Statistics, where the image was looked at.
        statistics: Maybe<FrameStatistics> => "";
        /// Peak of the brightest source, by which focus is judged.
        focus_metric_adu: Maybe<f64> => "ADU" [0.0, 1e10];
        /// Sources found.
        sources_found: U16Le => "";
        /// Sources that patterns were made of.
        sources_tried: U16Le => "";
        /// Sources matched to stars; 0 where not solved.
        sources_matched: U16Le => "";
        /// Candidate attitudes screened.
        candidates_tried: U32Le => "";
        /// From pixels in memory to the outcome.
        solve_time_ms: Maybe<f64> => "ms" [0.0, 1e9];
        /// The pointing, where solved.
        equatorial: Maybe<Equatorial> => "";
        /// The same pointing against the horizon, where latitude and sidereal time were known.
        horizontal: Maybe<HorizontalPart> => "";
        /// How far the pointing lies from the prior that it disagrees with; unknown where it agrees or there was none.
        prior_disagreement_deg: Maybe<f64> => "deg" [0.0, 180.0];
        /// Corrections that the pointing has.
        corrections: Corrections => "";
        /// How many of the sources below there are.
        sources_count: u8 => "" [0.0, 20.0];
        /// The first sources, brightest first, solved or not.
        sources: List<Source, 20> => "";
    }
}

body! {
    /// Statistics of an image.
    pub struct FrameStatistics {
        /// Mean of the cells' means.
        mean_adu: f64 => "ADU" [0.0, 1e7];
        /// Median of the cells' standard deviations.
        noise_adu: f64 => "ADU" [0.0, 1e7];
        /// Gain measured from photon noise.
        measured_gain_adu_per_e: Maybe<f64> => "ADU/e-" [0.0, 1e7];
        /// The same against the camera's gain at 0 dB: 20 log10(gain / ideal gain).
        measured_gain_db: Maybe<f64> => "dB" [-1000.0, 1000.0];
        /// Saturated pixels.
        saturated_px: U32Le => "px";
        /// Saturated pixels as a fraction of the image.
        saturated_fraction: f64 => "" [0.0, 1.0];
        /// Median full width at half maximum of the better sources.
        fwhm_px: Maybe<f64> => "px" [0.0, 10000.0];
    }
}

body! {
    /// A pointing: the boresight is the centre of the image.
    pub struct Equatorial {
        /// Right ascension of the boresight, ICRS; of date where the camera's `solver.fit.precession` is switched on.
        ra_deg: f64 => "deg" [0.0, 360.0];
        /// Declination of the boresight, as right ascension.
        dec_deg: f64 => "deg" [-90.0, 90.0];
        /// Position angle of the image's up direction, from North through East.
        roll_deg: f64 => "deg" [-180.0, 180.0];
        /// One standard deviation towards East, on the sky.
        sigma_east_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// One standard deviation towards North.
        sigma_north_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// One standard deviation of the roll.
        sigma_roll_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// Mean of the standard deviations towards East and North.
        sigma_pointing_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// Covariance, rows and columns in the order East, North, roll.
        covariance_arcsec2: List<List<f64, 3>, 3> => "arcsec^2" [-1e14, 1e14];
        /// Plate scale at the centre.
        platescale_arcsec_px: f64 => "arcsec/px" [0.0, 1e6];
        /// One standard deviation of the plate scale.
        sigma_platescale_arcsec_px: Maybe<f64> => "arcsec/px" [0.0, 1e6];
        /// Radial distortion at the half diagonal.
        distortion_k1: Maybe<f64> => "" [-10.0, 10.0];
        /// Root mean square of the residuals per axis.
        rms_px: f64 => "px" [0.0, 1e4];
        /// Weighted sum of squared residuals over the degrees of freedom.
        chi2_per_dof: Maybe<f64> => "" [0.0, 1e12];
        /// Upper bound on the probability that this pointing is false, as a power of ten.
        false_probability_log10: Maybe<f64> => "" [-1e6, 0.0];
        /// Julian year that the stars were moved to by proper motion.
        epoch_yr: Maybe<f64> => "yr" [1900.0, 2200.0];
    }
}

body! {
    /// A pointing against the horizon.
    pub struct HorizontalPart {
        /// Azimuth of the boresight, from north through east.
        az_deg: f64 => "deg" [0.0, 360.0];
        /// Elevation of the boresight.
        el_deg: f64 => "deg" [-90.0, 90.0];
        /// Angle of the image's up direction from the zenith, positive towards growing azimuth.
        horizontal_roll_deg: f64 => "deg" [-180.0, 180.0];
        /// One standard deviation along growing azimuth, on the sky.
        sigma_az_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// One standard deviation in elevation.
        sigma_el_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// One standard deviation of the horizontal roll.
        sigma_horizontal_roll_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// Mean of the standard deviations along azimuth and in elevation.
        sigma_horizontal_pointing_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// The observer that azimuth and elevation hold for.
        observer: ObserverPart => "";
        /// Julian year of the equinox that sidereal time was taken to refer to; unknown where ICRS was taken as it is.
        equinox_yr: Maybe<f64> => "yr" [1900.0, 2200.0];
    }
}

body! {
    /// Corrections that a pointing has.
    pub struct Corrections {
        /// Stars were moved to the epoch of observation.
        corrected_proper_motion: bool => "";
        /// The velocity of the Earth was allowed for.
        corrected_aberration: bool => "";
        /// Azimuth and elevation refer to the equinox of date.
        corrected_precession: bool => "";
        /// The bending of light in the air was allowed for.
        corrected_refraction: bool => "";
        /// The distortion of the optics was fitted or given.
        corrected_distortion: bool => "";
    }
}

body! {
    /// A source in an image.
    pub struct Source {
        /// Column in file order, centres of pixels at integers.
        x_px: f32 => "px" [-1e6, 1e6];
        /// Row in file order.
        y_px: f32 => "px" [-1e6, 1e6];
        /// One standard deviation of the position per axis.
        sigma_px: f32 => "px" [0.0, 1e6];
        /// Flux above the surroundings.
        flux_adu: f32 => "ADU" [-1e12, 1e12];
        /// Highest pixel above the surroundings.
        peak_adu: f32 => "ADU" [-1e10, 1e10];
        /// Signal over noise of the matched filter.
        snr: f32 => "" [-1e10, 1e10];
        /// A pixel of it is saturated.
        saturated: bool => "";
        /// The star that it was matched to, by its place in the camera's catalogue, brightest first.
        star_id: Maybe<U32Le> => "";
    }
}

impl Clock {
    /// What a clock says, and how far that can be believed.
    pub fn new(now: Option<Utc>, quality: ClockQuality) -> Self {
        Self { clock_unix_s: now.map(|utc| utc.unix_s()).into(), clock_quality: quality.into() }
    }
}
