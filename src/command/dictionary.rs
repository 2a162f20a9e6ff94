//! The commands: what the ground can ask for, each defined once.
//!
//! From the one declaration below come the typed [`Command`], its [`Definition`], validation, help, `stars fcp --send`, the
//! interface control document and the command dictionary. Codes and names are fixed: add, never change. The effects follow the
//! ground commands of the program that flew; `xsc_…` is what it called them.

use super::definition::{Definition, Hazard};
use super::value::{Parameter, ShowFocus, Value};

macro_rules! commands {
    ($(
        $(#[doc = $meaning:literal])+
        $code:literal $name:literal $variant:ident $flown:literal $hazard:ident {
            $( $(#[doc = $about:literal])+ $field:ident: $type:ty => $unit:literal [$low:literal, $high:literal]; )*
        }
    )+) => {
        /// A command with its values.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub enum Command {
            $(
                $(#[doc = $meaning])+
                $variant { $( $(#[doc = $about])+ $field: $type, )* },
            )+
        }

        impl Command {
            /// Its number on the wire.
            pub fn code(&self) -> u8 {
                match self { $( Self::$variant { .. } => $code, )+ }
            }

            /// Its values as plain numbers, in the order of the definition.
            pub fn numbers(&self) -> Vec<f64> {
                match self { $( Self::$variant { $($field),* } => vec![$( $field.number() ),*], )+ }
            }

            /// From numbers that the definition has let through; one that is missing is 0.
            pub(super) fn from_checked(code: u8, numbers: &[f64]) -> Option<Self> {
                let mut numbers = numbers.iter().copied();
                match code {
                    $( $code => Some(Self::$variant { $( $field: <$type>::of(numbers.next().unwrap_or_default()), )* }), )+
                    _ => None,
                }
            }
        }

        /// Every command, in the order of the declaration.
        pub(super) fn all() -> Vec<Definition> {
            vec![$( Definition {
                code: $code,
                name: $name,
                meaning: concat!($($meaning),+).trim_ascii(),
                flown: $flown,
                hazard: Hazard::$hazard,
                parameters: vec![$( Parameter {
                    name: stringify!($field),
                    shape: <$type>::SHAPE,
                    unit: $unit,
                    low: f64_of!($low),
                    high: f64_of!($high),
                    meaning: concat!($($about),+).trim_ascii(),
                } ),*],
            } ),+]
        }
    };
}

/// A bound as a float, whether it was written as one or not.
macro_rules! f64_of {
    ($literal:literal) => {
        $literal as f64
    };
}

commands! {
    /// Ends the program; whatever watches over it starts it again.
    1 "service.quit" Quit "xsc_quit" Always {}
    /// Runs the program of the settings that switches the computer off, or the one that restarts it.
    2 "service.shut_down" ShutDown "xsc_shutdown" Always {
        /// Restart instead of switching off.
        restart: bool => "" [0, 1];
    }
    /// Runs the program of the settings that resets the network.
    3 "service.reset_network" ResetNetwork "xsc_network_reset" None {}
    /// Sets whether the network is reset by itself when no flight computer has been heard for long.
    4 "service.set_network_lull" SetNetworkLull "xsc_network_reset" None {
        /// Do it.
        enabled: bool => "" [0, 1];
        /// Time without a word from any flight computer before it.
        delay_s: f64 => "s" [60, 86400];
    }
    /// Takes back everything that was commanded: settings, ranges and masks are again those of the files that the program
    /// started with. The lens is not moved.
    5 "service.factory_reset" FactoryReset "" Always {}
    /// From any state to the flight defaults with the lens at rest: stops the lens, ends the autofocus without a move, takes back
    /// everything that was commanded, disarms. Acts blind, whatever else is wrong.
    6 "service.known_good" KnownGood "" None {}
    /// Sets what the display shows.
    7 "display.configure" ConfigureDisplay "xsc_main_settings" None {
        /// Times per second that a page shows the state anew, at most.
        rate_hz: f64 => "Hz" [1, 30];
        /// Fill the screen.
        full_screen: bool => "" [0, 1];
        /// Show the image alone.
        image_only: bool => "" [0, 1];
        /// Show the requirements.
        show_requirements: bool => "" [0, 1];
        /// Brightness of the image.
        brightness: f64 => "" [0.5, 4];
    }
    /// Magnifies a part of the display.
    8 "display.set_zoom" SetZoom "xsc_display_zoom" None {
        /// Centre, from the left of a display of 640 px.
        x_px: i32 => "px" [0, 1000];
        /// Centre, from the bottom of a display of 480 px.
        y_px: i32 => "px" [0, 1000];
        /// Magnification.
        magnification: f64 => "" [1, 4];
    }
    /// Sends each new image to the flight computers that ask for the next one, and to those of old that have images set; or no longer.
    9 "images.send" SendImages "xsc_image_client" None {
        /// Send them.
        enabled: bool => "" [0, 1];
    }
    /// Sets how long the triggers of a series are waited for: those that come within this time of the first make one image.
    10 "camera.set_series" SetSeries "xsc_multi_trigger" None {
        /// Time from the first exposure of a series to the last.
        readout_delay_s: f64 => "s" [0.1, 10];
    }
    /// Reads the camera's gain.
    11 "camera.get_gain" GetGain "xsc_get_gain" None {}
    /// Sets the camera's gain.
    12 "camera.set_gain" SetGain "xsc_set_gain" None {
        /// Gain.
        gain_db: f64 => "dB" [0, 36];
    }
    /// Pretends a brighter sky than there is, where `brightness.allowed` is set; the images that are kept stay as they are.
    13 "simulator.set_brightness" SetBrightness "xsc_fake_sky_brightness" None {
        /// Do it.
        enabled: bool => "" [0, 1];
        /// Brightness of the sky, thousands of electrons per second and pixel.
        level_ke_s_px: f64 => "ke-/s/px" [0, 10000];
        /// Gain of the simulated camera.
        gain_db: f64 => "dB" [-50, 10];
        /// Exposure that was made.
        actual_exposure_s: f64 => "s" [0.01, 10];
        /// Exposure to pretend.
        simulated_exposure_s: f64 => "s" [0.01, 10];
    }
    /// Empties the lens controller's input, so that the next command is read from its first character.
    20 "lens.flush" FlushLens "" None {}
    /// Lets the lens find its focus range, for which it moves from end to end.
    21 "lens.init_focus" InitFocus "xsc_init_focus" Always {}
    /// Reads the focus position.
    22 "lens.get_focus" GetFocus "" None {}
    /// Moves the focus to a position.
    23 "lens.set_focus" SetFocus "xsc_set_focus" LargeMove {
        /// Position, encoder counts from the near stop.
        position_counts: i32 => "counts" [0, 65535];
    }
    /// Moves the focus by so much.
    24 "lens.move_focus" MoveFocus "xsc_set_focus_incremental" LargeMove {
        /// Counts, away from the near stop if positive.
        step_counts: i32 => "counts" [-10000, 10000];
    }
    /// Lets the aperture find its stops, for which it moves.
    25 "lens.init_aperture" InitAperture "xsc_init_aperture" None {}
    /// Reads the aperture position.
    26 "lens.get_aperture" GetAperture "" None {}
    /// Moves the aperture to a position.
    27 "lens.set_aperture" SetAperture "xsc_set_aperture" None {
        /// Position, 0 is fully open.
        position_counts: i32 => "counts" [0, 10000];
    }
    /// Sends nothing more that moves the lens: queued moves and the autofocus end. A move that has begun cannot be stopped.
    28 "lens.stop" StopLens "" None {}
    /// Sweeps the focus over its range and moves to where the stars are sharpest.
    40 "focus.run" RunFocus "xsc_run_autofocus" Always {}
    /// Sets the range of the focus search.
    41 "focus.set_range" SetFocusRange "xsc_set_autofocus_range" None {
        /// Nearest position.
        min_counts: i32 => "counts" [0, 65535];
        /// Furthest position.
        max_counts: i32 => "counts" [0, 65535];
        /// Distance between positions.
        step_counts: i32 => "counts" [1, 1000];
    }
    /// Ends an autofocus.
    42 "focus.abort" AbortFocus "xsc_abort_autofocus" None {
        /// Move to the best focus that is known by then; otherwise the lens goes back to where it was before.
        use_result: bool => "" [0, 1];
    }
    /// Goes one bounded step and compares the stars; comes back by itself if they did not get better.
    43 "focus.refocus" Refocus "" None {
        /// The step, away from the near stop if positive; `focus.refocus_counts` bounds it.
        step_counts: i32 => "counts" [-1000, 1000];
    }
    /// Sweeps the focus over its range, says where the stars are sharpest, and goes back to where the lens was.
    45 "focus.advise" AdviseFocus "" Always {}
    /// Sets when the display shows the autofocus.
    44 "focus.set_display" SetFocusDisplay "xsc_autofocus_display_mode" None {
        /// When.
        show: ShowFocus => "" [0, 2];
    }
    /// Switches solving on or off, and sets its time limit.
    60 "solver.configure" ConfigureSolver "xsc_solver_general" None {
        /// Solve frames.
        enabled: bool => "" [0, 1];
        /// A frame older than this is given up.
        timeout_s: f64 => "s" [1, 600];
    }
    /// Gives up the frame that is being solved.
    61 "solver.abort" AbortSolver "xsc_solver_abort" None {}
    /// Sets the mask of blocks that no source is taken from, for images of at most 96 blocks.
    62 "solver.mask" MaskSources "xsc_selective_mask" None {
        /// Apply it.
        enabled: bool => "" [0, 1];
        /// Blocks 0 to 31, lowest bit first, rows from the bottom.
        field_0: u32 => "" [0, 4294967295.0];
        /// Blocks 32 to 63.
        field_1: u32 => "" [0, 4294967295.0];
        /// Blocks 64 to 95.
        field_2: u32 => "" [0, 4294967295.0];
    }
    /// Sets how sources are found.
    63 "solver.sources" FindSources "xsc_blob_finding" None {
        /// How far a peak stands above its surroundings, in σ of the noise.
        snr_threshold: f64 => "" [0.01, 10];
        /// Sources that patterns are made of.
        max_sources: u32 => "" [4, 32];
        /// Search again with wide kernels where the normal search fails.
        robust: bool => "" [0, 1];
    }
    /// Sets how crowding is limited.
    64 "solver.cells" LimitCells "xsc_blob_cells" None {
        /// Side of a cell.
        cell_px: u32 => "px" [8, 16384];
        /// Most sources taken from a cell.
        max_per_cell: u32 => "" [1, 10];
    }
    /// Sets the use of the gyro rates of trailed images.
    65 "solver.motion" UseMotion "xsc_motion_psf" None {
        /// Use them.
        enabled: bool => "" [0, 1];
    }
    /// Sets how sources are matched to stars.
    66 "solver.matching" MatchStars "xsc_pattern_matching" None {
        /// Match them at all.
        enabled: bool => "" [0, 1];
        /// Greatest distance of a source from its star.
        tolerance_px: f64 => "px" [0.5, 10];
        /// Least plate scale.
        platescale_min_arcsec_px: f64 => "arcsec/px" [0.1, 1000];
        /// Greatest plate scale.
        platescale_max_arcsec_px: f64 => "arcsec/px" [0.1, 1000];
    }
    /// Requires solutions to lie near the flight computer's estimate, against the horizon.
    80 "requirements.horizontal_location" RequireHorizontalLocation "xsc_filter_hor_location" None {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Greatest distance.
        radius_deg: f64 => "deg" [0.1, 180];
    }
    /// Requires the horizontal roll to lie in a range.
    81 "requirements.horizontal_roll" RequireHorizontalRoll "xsc_filter_hor_roll" None {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Lower end.
        min_deg: f64 => "deg" [-180, 180];
        /// Upper end.
        max_deg: f64 => "deg" [-180, 180];
    }
    /// Requires the elevation to lie in a range.
    82 "requirements.elevation" RequireElevation "xsc_filter_el" None {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Lower end.
        min_deg: f64 => "deg" [-90, 90];
        /// Upper end.
        max_deg: f64 => "deg" [-90, 90];
    }
    /// Requires solutions to lie near the flight computer's estimate, on the sky.
    83 "requirements.equatorial_location" RequireEquatorialLocation "xsc_filter_eq_location" None {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Greatest distance.
        radius_deg: f64 => "deg" [0.1, 180];
    }
    /// Requires the roll to lie in a range.
    84 "requirements.equatorial_roll" RequireEquatorialRoll "" None {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Lower end.
        min_deg: f64 => "deg" [-180, 180];
        /// Upper end.
        max_deg: f64 => "deg" [-180, 180];
    }
    /// Sets what a solution must be like to be served.
    85 "requirements.matching" RequireMatching "xsc_filter_matching" None {
        /// Greatest σ of the pointing.
        pointing_error_max_arcsec: f64 => "arcsec" [0.1, 200];
        /// Greatest rms residual.
        fit_error_max_px: f64 => "px" [0.1, 2000];
        /// Fewest matched sources.
        min_matched: u32 => "" [3, 20];
    }
}
