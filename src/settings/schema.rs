//! Every parameter of the program, one struct per section of `config/flight.toml`.
//!
//! The file is the only place for defaults, so nothing here has one, and an unknown or missing key is an error.
//! Units are in the names; angles are in degrees or arcseconds here and become radians where they are used.

use super::sensor::SensorSource;
use serde::{Deserialize, Serialize};

/// The whole configuration of one star camera, as merged from the flight file, the custom file and the command line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The camera: where frames come from and how they are laid out.
    pub camera: CameraSettings,
    /// Exposure and gain by what frames show.
    pub auto_exposure: AutoExposureSettings,
    /// The simulated sky that `camera.kind = "sky"` looks at.
    pub simulate: SimulateSettings,
    /// A brighter sky than there is.
    pub brightness: BrightnessSettings,
    /// The lens controller.
    pub lens: LensSettings,
    /// The autofocus: where it searches, how far it steps, how long it may take.
    pub focus: FocusSettings,
    /// The star catalogue and what is derived from it.
    pub catalog: CatalogSettings,
    /// From pixels to pointing.
    pub solver: SolverSettings,
    /// Where the observer's latitude and sidereal time may come from.
    pub observer: ObserverSettings,
    /// The connections to the flight computers.
    pub network: NetworkSettings,
    /// Images for flight computers.
    pub images: ImageSettings,
    /// The port for flight programs of old.
    pub legacy: LegacySettings,
    /// What is done with commands.
    pub commands: CommandSettings,
    /// The page for browsers.
    pub display: DisplaySettings,
    /// What is kept on disk.
    pub record: RecordSettings,
    /// Temperatures, pressure and disk.
    pub housekeeping: HousekeepingSettings,
    /// How the service looks after itself.
    pub service: ServiceSettings,
    /// The computer's clock.
    pub clock: ClockSettings,
}

/// What produces frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CameraKind {
    /// Image files of a directory, in the order of their names.
    Directory,
    /// A sky rendered from the catalogue.
    Sky,
    /// A GigE Vision or USB3 Vision camera. Known by name in every program, so that settings written for it read.
    Aravis,
    /// No camera: the service runs and says so.
    None,
}

/// What makes a real camera expose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the lines have the camera's own names")]
pub enum Trigger {
    /// A command of ours for each frame.
    Software,
    /// Nothing: it exposes at a rate of its own.
    Free,
    Line0,
    Line1,
    Line2,
    Line3,
}

impl Trigger {
    /// Its name in the standard of cameras (GenICam); none where there is no trigger.
    pub fn genicam(self) -> Option<&'static str> {
        match self {
            Self::Software => Some("Software"),
            Self::Free => None,
            Self::Line0 => Some("Line0"),
            Self::Line1 => Some("Line1"),
            Self::Line2 => Some("Line2"),
            Self::Line3 => Some("Line3"),
        }
    }

    /// Whether others trigger, on a line of the camera's.
    pub fn is_line(self) -> bool {
        !matches!(self, Self::Software | Self::Free)
    }
}

/// What sets the computer's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockReference {
    /// Nothing more is known than whether it is set.
    Unknown,
    /// chrony.
    Chrony,
    /// PTP, with linuxptp's `ptp4l` and `phc2sys`.
    Ptp,
}

/// What a real camera sends for a pixel: so many bits, in a byte or in two.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum PixelFormat {
    Mono8,
    Mono10,
    Mono12,
    Mono14,
    Mono16,
}

impl PixelFormat {
    /// Its name in the standard of cameras (GenICam).
    pub fn genicam(self) -> &'static str {
        match self {
            Self::Mono8 => "Mono8",
            Self::Mono10 => "Mono10",
            Self::Mono12 => "Mono12",
            Self::Mono14 => "Mono14",
            Self::Mono16 => "Mono16",
        }
    }

    /// Bytes of a pixel.
    pub fn bytes(self) -> usize {
        if self == Self::Mono8 { 1 } else { 2 }
    }

    /// Highest value of a pixel, ADU.
    pub fn full_scale_adu(self) -> u16 {
        match self {
            Self::Mono8 => 0xff,
            Self::Mono10 => 0x3ff,
            Self::Mono12 => 0xfff,
            Self::Mono14 => 0x3fff,
            Self::Mono16 => 0xffff,
        }
    }
}

/// Section `[camera]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSettings {
    /// Name of this sensor, at most 16 ASCII characters (per camera; the original's `main.which_sensor`).
    pub name: String,
    /// What produces frames.
    pub kind: CameraKind,
    /// Directory of images for `kind = "directory"`.
    pub directory: String,
    /// Which camera `kind = "aravis"` is: its identifier or address; the first where empty.
    pub device: String,
    /// What makes it expose.
    pub trigger: Trigger,
    /// Without a trigger of others' for so long it exposes by itself, s; 0: never.
    pub trigger_timeout_s: f64,
    /// Exposure time of it, s.
    pub exposure_s: f64,
    /// Gain that it has at the start, dB.
    pub gain_db: f64,
    /// What it sends for a pixel.
    pub pixel_format: PixelFormat,
    /// More of its features, `Name=value` one after the other.
    pub features: String,
    /// Exposures of an image, at most where others trigger them.
    pub series_exposures: u32,
    /// Time from the first exposure of a series to the last, where others trigger them, s.
    pub series_s: f64,
    /// Images `<stem>_p0…_p3` of one series are co-added.
    pub stack_parts: bool,
    /// Start again with the first image after the last.
    pub repeat: bool,
    /// Time from start to the first frame, s.
    pub startup_delay_s: f64,
    /// Time between frames, s.
    pub period_s: f64,
    /// Columns of a frame, px.
    pub width_px: u32,
    /// Rows of a frame, px.
    pub height_px: u32,
    /// Optics turn the picture over: seen with North up, East is to the right.
    pub mirrored: bool,
    /// Highest value that a single exposure can have, ADU; 0 where it is to be found from the image.
    pub full_scale_adu: u32,
    /// ADU per electron at 0 dB, to which a measured gain is compared.
    pub ideal_gain_adu_per_e: f64,
}

/// Section `[auto_exposure]`: exposure and gain by what frames show.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AutoExposureSettings {
    /// Whether it is done.
    pub enabled: bool,
    /// The frame's mean is kept above this, of its full scale, unless there are enough sources.
    pub sky_low: f64,
    /// And below this.
    pub sky_high: f64,
    /// More saturated pixels than this, of all, and there is too much light.
    pub saturated_max: f64,
    /// With so many sources found there is enough light.
    pub enough_sources: u32,
    /// Bounds of one exposure, s.
    pub exposure_min_s: f64,
    /// See [`Self::exposure_min_s`].
    pub exposure_max_s: f64,
    /// Bounds of the gain, dB.
    pub gain_min_db: f64,
    /// See [`Self::gain_min_db`].
    pub gain_max_db: f64,
}

/// Section `[simulate]`: the rendered sky of `camera.kind = "sky"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulateSettings {
    /// Kind of frame (see `stars render --help`).
    pub kind: String,
    /// Seed of everything random in the simulation.
    pub seed: u64,
    /// Elevation of the gondola's boresight, deg.
    pub elevation_deg: f64,
    /// Azimuth rate of the gondola's scan, deg/s.
    pub scan_rate_deg_s: f64,
    /// Half the width of the gondola's azimuth scan, deg.
    pub scan_amplitude_deg: f64,
    /// Latitude of the simulated observer, deg.
    pub latitude_deg: f64,
    /// Where the simulated lens is in focus, encoder counts.
    pub best_focus_counts: i32,
}

/// Section `[brightness]`: the sky that is pretended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BrightnessSettings {
    /// Whether it may be switched on.
    pub allowed: bool,
    /// Whether it is.
    pub enabled: bool,
    /// Brightness of the sky, thousands of electrons per second and pixel.
    pub level_ke_s_px: f64,
    /// Gain to pretend, dB.
    pub gain_db: f64,
    /// Exposure that is made, s.
    pub actual_exposure_s: f64,
    /// Exposure to pretend, s.
    pub simulated_exposure_s: f64,
}

/// What stands behind the lens port.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LensKind {
    /// A controller on a serial port.
    Serial,
    /// A simulated controller.
    Simulated,
    /// No lens control.
    None,
}

/// Section `[lens]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LensSettings {
    /// What stands behind the port.
    pub kind: LensKind,
    /// Path of the serial port for `kind = "serial"`; `auto`: looked for.
    pub port: String,
    /// Speed of the serial line, baud.
    pub baud: u32,
    /// Drive to both stops to learn the range, and open the aperture, when the controller is found for the first time.
    pub init_on_startup: bool,
    /// Learn the range anew by itself, and go back, after the controller forgot it or lost counts.
    pub relearn: bool,
    /// Least time between learning it by itself, s.
    pub relearn_pause_s: f64,
    /// Moves of the focus over this have to be armed, counts.
    pub large_move_counts: u32,
    /// A position this near to another is the same, counts.
    pub tolerance_counts: u32,
    /// A reply to a word that doesn't move comes within this time, s.
    pub reply_timeout_s: f64,
    /// A reply to a word that moves comes within this time, s.
    pub move_timeout_s: f64,
    /// A reply to the word that learns the range comes within this time, s.
    pub learn_timeout_s: f64,
    /// Times that a question is asked again.
    pub retries: u32,
    /// Pause before something unknown is read again, s.
    pub retry_pause_s: f64,
    /// Time between reads of a lens at rest, s.
    pub check_period_s: f64,
    /// Time between searches for the controller, s.
    pub search_period_s: f64,
    /// The simulated controller.
    pub simulated: SimulatedLensSettings,
}

/// Section `[lens.simulated]`: the controller of `lens.kind = "simulated"`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedLensSettings {
    /// From stop to stop, encoder counts.
    pub range_counts: i32,
    /// Where the focus is at the start, encoder counts from the near stop.
    pub start_counts: i32,
    /// Speed of the focus, counts/s.
    pub speed_counts_s: f64,
    /// Play between motor and optics, counts.
    pub backlash_counts: f64,
    /// All its times are divided by this.
    pub speedup: f64,
    /// Faults and when they come; empty: none.
    pub faults: String,
}

/// Section `[focus]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FocusSettings {
    /// Nearest position of a focus search, encoder counts (per camera).
    pub search_min_counts: i32,
    /// Furthest position of a focus search, encoder counts (per camera).
    pub search_max_counts: i32,
    /// Finest step of a focus search, encoder counts; wider ones are taken where the time asks for them.
    pub step_counts: i32,
    /// Longest time that a focus search takes images for, s.
    pub time_allowed_s: f64,
    /// The display shows the curves for this long after a search, s.
    pub grace_s: f64,
    /// Positions are approached from below for this long at least, encoder counts.
    pub backlash_counts: i32,
    /// Furthest that a refocus goes from where the lens was, encoder counts.
    pub refocus_counts: i32,
    /// Growth of the blur disc's diameter away from best focus, px a count (per lens).
    pub blur_px_per_count: f64,
    /// Full width at half maximum of stars in best focus, px (per lens).
    pub sharp_width_px: f64,
}

/// Section `[catalog]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CatalogSettings {
    /// Catalogue file; empty for the one built into the program.
    pub file: String,
    /// Directory in which the index is kept for the next start; empty for none.
    pub cache_directory: String,
    /// Epoch of observation where a frame does not know its own, Julian year.
    pub epoch_yr: f64,
    /// Stars closer than this are one source to the camera and are merged, px.
    pub blend_px: f64,
    /// Stars per field that triangles are made of.
    pub index_stars_per_field: f64,
    /// Stars per field that candidates are checked against.
    pub verification_stars_per_field: f64,
    /// Longest side of an indexed triangle, fraction of the field's diagonal.
    pub longest_side_fraction: f64,
}

/// Section `[solver]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SolverSettings {
    /// Solve at all.
    pub enabled: bool,
    /// A frame older than this is given up, s since its capture.
    pub timeout_s: f64,
    /// Try again with wide kernels where the normal search did not solve.
    pub robust: bool,
    /// Threads that work on one frame.
    pub threads: u32,
    /// More saturated pixels than this end the frame as `saturated`, fraction of the frame.
    pub saturation_limit_fraction: f64,
    /// Refuse a solution that disagrees with the prior, however sure it is.
    pub prior_veto: bool,
    /// Finding sources.
    pub sources: SourceSettings,
    /// Areas that sources are not taken from.
    pub mask: MaskSettings,
    /// Matching sources to stars.
    pub matching: MatchingSettings,
    /// What earlier frames say of the next.
    pub tracking: TrackingSettings,
    /// How gyro rates are used.
    pub motion: MotionSettings,
    /// Fitting the attitude.
    pub fit: FitSettings,
    /// What a solution must satisfy.
    pub requirements: RequirementSettings,
}

/// Section `[solver.sources]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceSettings {
    /// A peak must stand this many times the local noise above its surroundings in the smoothed image.
    pub snr_threshold: f64,
    /// A source must have at least this matched-filter signal over noise.
    pub min_snr: f64,
    /// Sources that patterns are made of.
    pub max_sources: u32,
    /// Sources that the final fit may use.
    pub max_found: u32,
    /// Side of the square cells that limit crowding, px.
    pub cell_px: u32,
    /// Sources taken from one cell.
    pub max_per_cell: u32,
    /// Sources closer to the image's border are not taken, px.
    pub border_px: u32,
    /// File of bad pixels, `x y` a line; empty for none.
    pub bad_pixels_file: String,
}

/// Section `[solver.mask]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskSettings {
    /// Apply the mask.
    pub enabled: bool,
    /// Side of a block, px.
    pub block_px: u32,
    /// Masked blocks as words of 32 bits, lowest bit first; block n = row × blocks per row + column, rows from the bottom.
    pub fields: Vec<u32>,
}

/// Section `[solver.matching]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MatchingSettings {
    /// Match patterns at all.
    pub enabled: bool,
    /// Least plate scale, arcsec/px (per camera).
    pub platescale_min_arcsec_px: f64,
    /// Greatest plate scale, arcsec/px (per camera).
    pub platescale_max_arcsec_px: f64,
    /// A source within this distance of a star may be that star, px.
    pub tolerance_px: f64,
    /// Fewest matched sources of a solution; the computed threshold decides above it.
    pub min_matched: u32,
    /// Greatest probability that a served solution is false, log10.
    pub max_false_probability_log10: f64,
    /// Candidate attitudes that may be screened for a list of sources; a frame's lists have parts of it.
    pub candidate_budget: u32,
}

/// Section `[solver.tracking]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackingSettings {
    /// Search near the last solution first.
    pub enabled: bool,
    /// Fewest matched sources of a solution found there.
    pub min_matched: u32,
    /// The last solution says nothing after this long, s.
    pub max_age_s: f64,
    /// Growth of one σ of the attitude where nobody says how the camera moves, deg/s.
    pub drift_deg_s: f64,
    /// One σ of what a flight computer says that the camera turned by, deg.
    pub estimate_sigma_deg: f64,
    /// Growth of it, deg/s.
    pub estimate_drift_deg_s: f64,
    /// One σ of the change of the plate scale from frame to frame, fraction.
    pub platescale_sigma: f64,
}

/// Section `[solver.motion]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionSettings {
    /// Use the gyros' rates.
    pub enabled: bool,
    /// How long an image that is not solved waits for them, s.
    pub wait_s: f64,
    /// Horizontal roll until a solution has told it, deg.
    pub roll_deg: f64,
    /// One σ of the gyros' drift in a second, arcsec.
    pub gyro_drift_arcsec: f64,
}

/// Section `[solver.fit]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitSettings {
    /// The radial distortion k1 that is expected, at the half diagonal.
    pub distortion_k1: f64,
    /// How well that is known beforehand, one σ.
    pub distortion_sigma: f64,
    /// Where the lens's axis is expected to meet the picture, from its centre along left, px.
    pub axis_left_px: f64,
    /// The same along up, px.
    pub axis_up_px: f64,
    /// How far from there it may be, one σ per axis, px.
    pub axis_sigma_px: f64,
    /// Error of a centroid that no photon noise explains, px, one σ per axis.
    pub centroid_floor_px: f64,
    /// Apply proper motion to the epoch of observation.
    pub proper_motion: bool,
    /// Put the stars where they are seen from the moving Earth.
    pub aberration: bool,
    /// Give equatorial coordinates on the true equator and equinox of date.
    pub precession: bool,
    /// Give azimuth and elevation as seen through the air.
    pub refraction: bool,
    /// Pressure of that air at the observer, hPa.
    pub pressure_hpa: f64,
    /// Temperature of that air at the observer, °C.
    pub temperature_c: f64,
}

/// Section `[solver.requirements]`: every one refuses by its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RequirementSettings {
    /// Distance from an azimuth and elevation.
    pub horizontal_location: HorizontalLocationLimit,
    /// Range of the horizontal roll.
    pub horizontal_roll: AngleRange,
    /// Range of the elevation.
    pub elevation: AngleRange,
    /// Distance from a right ascension and declination.
    pub equatorial_location: EquatorialLocationLimit,
    /// Range of the equatorial roll.
    pub equatorial_roll: AngleRange,
    /// Greatest σ of the pointing, mean of the two axes on the sky, arcsec.
    pub pointing_error_max_arcsec: f64,
    /// Greatest rms residual of the fit, px.
    pub fit_error_max_px: f64,
}

/// A circle around a horizontal position; the flight computer's estimate takes the centre's place where it sends one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HorizontalLocationLimit {
    /// Require it.
    pub enabled: bool,
    /// Radius, deg.
    pub radius_deg: f64,
    /// Azimuth of the centre, deg.
    pub az_deg: f64,
    /// Elevation of the centre, deg.
    pub el_deg: f64,
}

/// A circle around an equatorial position; the flight computer's estimate takes the centre's place where it sends one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EquatorialLocationLimit {
    /// Require it.
    pub enabled: bool,
    /// Radius, deg.
    pub radius_deg: f64,
    /// Right ascension of the centre, deg.
    pub ra_deg: f64,
    /// Declination of the centre, deg.
    pub dec_deg: f64,
}

/// A range of an angle, wrapping where the angle does: from `min_deg` upwards to `max_deg`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AngleRange {
    /// Require it.
    pub enabled: bool,
    /// Lower end, deg.
    pub min_deg: f64,
    /// Upper end, deg.
    pub max_deg: f64,
}

/// Section `[observer]`: sources in order of preference; the first that is enabled and knows is taken.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObserverSettings {
    /// Use what the flight computer in charge sends.
    pub from_flight_computer: bool,
    /// What a flight computer sent is good for this long, s.
    pub max_age_s: f64,
    /// Use the fixed values below.
    pub from_settings: bool,
    /// Latitude, deg.
    pub latitude_deg: f64,
    /// Local sidereal time, hours.
    pub sidereal_time_h: f64,
    /// Use the keywords of an image file.
    pub from_image: bool,
}

/// Section `[network]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkSettings {
    /// Address and port that flight computers connect to.
    pub listen: String,
    /// Addresses that may connect; empty for any.
    pub peers: Vec<String>,
    /// Time between updates, s.
    pub update_period_s: f64,
    /// A peer silent for this long is closed, s.
    pub silence_s: f64,
    /// Connections held at a time.
    pub max_connections: u32,
    /// Connections of one address in a second.
    pub connections_per_s: u32,
}

/// Section `[images]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImageSettings {
    /// Send each new image to the flight computers that ask for the next one, and to those of old.
    pub send: bool,
    /// Most bytes of images in a second, to each flight computer.
    pub rate_bytes_s: f64,
}

/// Section `[legacy]`: the dialect of the program that flew, protocol version 3.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LegacySettings {
    /// Speak it.
    pub enabled: bool,
    /// Address and port that flight computers which speak it connect to.
    pub listen: String,
    /// Addresses of the flight computers: the first is number 1, the second number 2. Nobody else is taken.
    pub peers: Vec<String>,
    /// Send each of them the images that are kept, as the program that flew did.
    pub images: bool,
    /// Port of the image server on each of them.
    pub images_port: u16,
}

/// Section `[commands]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandSettings {
    /// A command that the ground gave longer ago is not run, s.
    pub window_s: f64,
    /// Run nothing whose sender does not show its key.
    pub require_authentication: bool,
    /// File with the key of flight computer 1; empty for none.
    pub key_file_1: String,
    /// File with the key of flight computer 2; empty for none.
    pub key_file_2: String,
    /// Directory of what outlasts a restart; empty: nothing does.
    pub ledger_directory: String,
    /// Program that switches the computer off; empty for none.
    pub shut_down_program: String,
    /// Program that restarts the computer; empty for none.
    pub restart_program: String,
    /// Program that resets the network; empty for none.
    pub network_reset_program: String,
    /// Reset the network when no flight computer was heard for long.
    pub network_lull: bool,
    /// How long, s.
    pub network_lull_s: f64,
}

/// Section `[display]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DisplaySettings {
    /// Address and port of the page.
    pub listen: String,
    /// Connections that are served at a time.
    pub max_clients: u32,
    /// Frames whose outcomes can be looked back at.
    pub history_frames: u32,
    /// Memory for their pixels, MiB.
    pub history_mib: u32,
    /// Times per second that the state goes to browsers, at most, Hz.
    pub rate_hz: f64,
    /// Give the whole screen to image and panels.
    pub full_screen: bool,
    /// Show the image alone.
    pub image_only: bool,
    /// Show the requirements.
    pub show_requirements: bool,
    /// Brightness of the image.
    pub brightness: f64,
    /// Centre of what is magnified, px from the left of a display of 640 × 480.
    pub zoom_x_px: u32,
    /// The same from the bottom, px.
    pub zoom_y_px: u32,
    /// Magnification.
    pub zoom: f64,
    /// When the autofocus is shown: `auto`, `on`, `off`.
    pub focus_panel: FocusPanel,
    /// The last solution is yellow when it is older, s.
    pub solution_age_yellow_s: f64,
    /// The last solution is red when it is older, s.
    pub solution_age_red_s: f64,
    /// The disk is yellow when it will be full sooner, d.
    pub disk_yellow_d: f64,
    /// The disk is red when it will be full sooner, d.
    pub disk_red_d: f64,
}

/// When the autofocus is shown instead of the image's figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FocusPanel {
    /// While it runs, and for a while after.
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Section `[record]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordSettings {
    /// Keep outcomes on disk.
    pub enabled: bool,
    /// Directory for logs.
    pub directory: String,
    /// Outcomes that may wait for the disk.
    pub queue_frames: u32,
    /// Keep every image too.
    pub images: bool,
    /// Directory for them; empty for the one that [`RecordSettings::image_directories`] says.
    pub images_directory: String,
    /// Directory on a second disk for the same; empty for none.
    pub copies_directory: String,
    /// What the images in one directory may take, GiB; 0 for as much as there is.
    pub images_limit_gib: f64,
    /// What images leave free on a disk, GiB.
    pub reserve_gib: f64,
    /// Images that may wait for each disk.
    pub queue_images: u32,
    /// Keep a journal of every input too.
    pub journal: bool,
    /// What journals may take, GiB; 0 for as much as there is.
    pub journal_limit_gib: f64,
}

impl RecordSettings {
    /// Where images are kept, with the key of each setting that says so; none where they are not.
    pub fn image_directories(&self) -> Vec<(&'static str, std::path::PathBuf)> {
        if !(self.enabled && self.images) {
            return Vec::new();
        }
        let first = match self.images_directory.as_str() {
            "" => std::path::Path::new(&self.directory).join("images"),
            directory => directory.into(),
        };
        let second =
            (!self.copies_directory.is_empty()).then(|| ("record.copies_directory", self.copies_directory.clone().into()));
        std::iter::once(("record.images_directory", first)).chain(second).collect()
    }
}

/// Section `[housekeeping]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HousekeepingSettings {
    /// Time between readings, s.
    pub period_s: f64,
    /// A value read longer ago than this is not known any more, s.
    pub max_age_s: f64,
    /// A program that is asked for a value ends within this time, s.
    pub command_timeout_s: f64,
    /// Less free space than this on the disk of the records is an alarm, GiB.
    pub disk_low_gib: f64,
    /// Less free space is red on the display, GiB.
    pub disk_red_gib: f64,
    /// The lens.
    pub temperature_lens: TemperatureSettings,
    /// The computer.
    pub temperature_computer: TemperatureSettings,
    /// The vessel.
    pub temperature_vessel: TemperatureSettings,
    /// The plate that carries camera and computer.
    pub temperature_plate: TemperatureSettings,
    /// The DC-DC converter.
    pub temperature_dcdc: TemperatureSettings,
    /// The flange between camera and lens.
    pub temperature_flange: TemperatureSettings,
    /// In the vessel.
    pub pressure: PressureSettings,
}

/// A temperature: where it comes from and its yellow and red limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TemperatureSettings {
    /// Where its value comes from.
    pub source: SensorSource,
    /// Below this it is an alarm, °C.
    pub low_c: f64,
    /// Above this it is an alarm, °C.
    pub high_c: f64,
    /// Below this the display is red, °C.
    pub red_low_c: f64,
    /// Above this the display is red, °C.
    pub red_high_c: f64,
}

/// A pressure: where it comes from and its yellow and red limits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PressureSettings {
    /// Where its value comes from.
    pub source: SensorSource,
    /// Below this it is an alarm, atm.
    pub low_atm: f64,
    /// Above this it is an alarm, atm.
    pub high_atm: f64,
    /// Below this the display is red, atm.
    pub red_low_atm: f64,
    /// Above this the display is red, atm.
    pub red_high_atm: f64,
}

/// Section `[service]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServiceSettings {
    /// First pause before a failed actor is started again, s; it doubles with each failure.
    pub restart_delay_s: f64,
    /// Longest such pause, s.
    pub restart_delay_max_s: f64,
    /// A part of the program that does not come round for this long hangs, and is started again, s.
    pub hang_s: f64,
}

/// Section `[clock]`: the computer's clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClockSettings {
    /// What sets it.
    pub reference: ClockReference,
    /// One σ of it while it follows its reference, s; 0: not known.
    pub sigma_s: f64,
}
