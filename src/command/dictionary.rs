//! The commands: what the ground can ask for, each defined once.
//!
//! From the one declaration below come the typed [`Command`], its [`Definition`], validation, help, `stars fcp --send`, the
//! interface control document and the command dictionary. Codes and names are fixed: add, never change. The effects follow the
//! ground commands of the program that flew; `xsc_…` is what it called them.

use super::value::{Parameter, ShowFocus, Value};

/// Values that a command may have at most; the wire has room for so many.
pub const MAX_VALUES: usize = 8;

/// Whether a command must be armed before it is fired.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hazard {
    /// It runs when it is sent.
    None,
    /// It is armed first, and fired then.
    Always,
    /// It must be armed where it moves the focus further than `lens.large_move_counts`, or from an unknown position.
    LargeMove,
}

/// What is known of a command besides its values.
#[derive(Debug, Clone, PartialEq)]
pub struct Definition {
    /// Its number on the wire.
    pub code: u8,
    /// Its name, `actor.verb_object`.
    pub name: &'static str,
    /// What it does.
    pub meaning: &'static str,
    /// The ground command of the program that flew; empty where there was none.
    pub flown: &'static str,
    /// Whether it must be armed.
    pub hazard: Hazard,
    /// Whether its part of the program is there; otherwise it is validated and answered `not_available`.
    pub available: bool,
    /// Its values, in the order of the wire.
    pub parameters: Vec<Parameter>,
}

macro_rules! commands {
    ($(
        $(#[doc = $meaning:literal])+
        $code:literal $name:literal $variant:ident $flown:literal $hazard:ident $available:literal {
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
            fn from_checked(code: u8, numbers: &[f64]) -> Option<Self> {
                let mut numbers = numbers.iter().copied();
                match code {
                    $( $code => Some(Self::$variant { $( $field: <$type>::of(numbers.next().unwrap_or_default()), )* }), )+
                    _ => None,
                }
            }
        }

        fn all() -> Vec<Definition> {
            vec![$( Definition {
                code: $code,
                name: $name,
                meaning: concat!($($meaning),+).trim_ascii(),
                flown: $flown,
                hazard: Hazard::$hazard,
                available: $available,
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
    1 "service.quit" Quit "xsc_quit" Always true {}
    /// Runs the program of the settings that switches the computer off, or the one that restarts it.
    2 "service.shut_down" ShutDown "xsc_shutdown" Always true {
        /// Restart instead of switching off.
        restart: bool => "" [0, 1];
    }
    /// Runs the program of the settings that resets the network.
    3 "service.reset_network" ResetNetwork "xsc_network_reset" None true {}
    /// Sets whether the network is reset by itself when no flight computer has been heard for long.
    4 "service.set_network_lull" SetNetworkLull "xsc_network_reset" None true {
        /// Do it.
        enabled: bool => "" [0, 1];
        /// Time without a word from any flight computer before it.
        delay_s: f64 => "s" [60, 86400];
    }
    /// Takes back everything that was commanded: settings, ranges and masks are again those of the files that the program
    /// started with. The lens is not moved.
    5 "service.factory_reset" FactoryReset "" Always true {}
    /// From any state to the flight defaults with the lens at rest: stops the lens, ends the autofocus without a move, takes back
    /// everything that was commanded, disarms. Acts blind, whatever else is wrong.
    6 "service.known_good" KnownGood "" None true {}
    /// Sets what the display shows.
    7 "display.configure" ConfigureDisplay "xsc_main_settings" None false {
        /// Pictures per second.
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
    8 "display.set_zoom" SetZoom "xsc_display_zoom" None false {
        /// Centre, from the left.
        x_px: i32 => "px" [0, 1000];
        /// Centre, from the bottom.
        y_px: i32 => "px" [0, 1000];
        /// Magnification.
        magnification: f64 => "" [1, 4];
    }
    /// Sends images to the flight computers, or no longer.
    9 "images.send" SendImages "xsc_image_client" None false {
        /// Send them.
        enabled: bool => "" [0, 1];
    }
    /// Sets how long the exposures of a series are waited for.
    10 "camera.set_series" SetSeries "xsc_multi_trigger" None false {
        /// Time from the first exposure of a series to the last.
        readout_delay_s: f64 => "s" [0.1, 10];
    }
    /// Reads the camera's gain.
    11 "camera.get_gain" GetGain "xsc_get_gain" None true {}
    /// Sets the camera's gain.
    12 "camera.set_gain" SetGain "xsc_set_gain" None true {
        /// Gain.
        gain_db: f64 => "dB" [0, 36];
    }
    /// Pretends a brighter sky than there is.
    13 "simulator.set_brightness" SetBrightness "xsc_fake_sky_brightness" None false {
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
    20 "lens.flush" FlushLens "" None true {}
    /// Lets the lens find its focus range, for which it moves from end to end.
    21 "lens.init_focus" InitFocus "xsc_init_focus" Always true {}
    /// Reads the focus position.
    22 "lens.get_focus" GetFocus "" None true {}
    /// Moves the focus to a position.
    23 "lens.set_focus" SetFocus "xsc_set_focus" LargeMove true {
        /// Position, encoder counts from the near stop.
        position_counts: i32 => "counts" [0, 65535];
    }
    /// Moves the focus by so much.
    24 "lens.move_focus" MoveFocus "xsc_set_focus_incremental" LargeMove true {
        /// Counts, away from the near stop if positive.
        step_counts: i32 => "counts" [-10000, 10000];
    }
    /// Lets the aperture find its stops, for which it moves.
    25 "lens.init_aperture" InitAperture "xsc_init_aperture" None true {}
    /// Reads the aperture position.
    26 "lens.get_aperture" GetAperture "" None true {}
    /// Moves the aperture to a position.
    27 "lens.set_aperture" SetAperture "xsc_set_aperture" None true {
        /// Position, 0 is fully open.
        position_counts: i32 => "counts" [0, 10000];
    }
    /// Sends nothing more that moves the lens: queued moves and the autofocus end. A move that has begun cannot be stopped.
    28 "lens.stop" StopLens "" None true {}
    /// Sweeps the focus over its range and moves to where the stars are sharpest.
    40 "focus.run" RunFocus "xsc_run_autofocus" Always true {}
    /// Sets the range of the focus search.
    41 "focus.set_range" SetFocusRange "xsc_set_autofocus_range" None true {
        /// Nearest position.
        min_counts: i32 => "counts" [0, 65535];
        /// Furthest position.
        max_counts: i32 => "counts" [0, 65535];
        /// Distance between positions.
        step_counts: i32 => "counts" [1, 1000];
    }
    /// Ends an autofocus.
    42 "focus.abort" AbortFocus "xsc_abort_autofocus" None true {
        /// Move to the best focus that is known by then; otherwise the lens stays where it is.
        use_result: bool => "" [0, 1];
    }
    /// Goes one bounded step and compares the stars; comes back by itself if they did not get better.
    43 "focus.refocus" Refocus "" None true {
        /// The step, away from the near stop if positive; `focus.refocus_counts` bounds it.
        step_counts: i32 => "counts" [-1000, 1000];
    }
    /// Sweeps the focus over its range, says where the stars are sharpest, and goes back to where the lens was.
    45 "focus.advise" AdviseFocus "" Always true {}
    /// Sets when the display shows the autofocus.
    44 "focus.set_display" SetFocusDisplay "xsc_autofocus_display_mode" None false {
        /// When.
        show: ShowFocus => "" [0, 2];
    }
    /// Switches solving on or off, and sets its time limit.
    60 "solver.configure" ConfigureSolver "xsc_solver_general" None true {
        /// Solve frames.
        enabled: bool => "" [0, 1];
        /// A frame older than this is given up.
        timeout_s: f64 => "s" [1, 600];
    }
    /// Gives up the frame that is being solved.
    61 "solver.abort" AbortSolver "xsc_solver_abort" None true {}
    /// Sets the mask of blocks that no source is taken from, for images of at most 96 blocks.
    62 "solver.mask" MaskSources "xsc_selective_mask" None true {
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
    63 "solver.sources" FindSources "xsc_blob_finding" None true {
        /// How far a peak stands above its surroundings, in σ of the noise.
        snr_threshold: f64 => "" [0.01, 10];
        /// Sources that patterns are made of.
        max_sources: u32 => "" [4, 32];
        /// Search again with wide kernels where the normal search fails.
        robust: bool => "" [0, 1];
    }
    /// Sets how crowding is limited.
    64 "solver.cells" LimitCells "xsc_blob_cells" None true {
        /// Side of a cell.
        cell_px: u32 => "px" [8, 16384];
        /// Most sources taken from a cell.
        max_per_cell: u32 => "" [1, 10];
    }
    /// Sets the use of the gyro rates of trailed images.
    65 "solver.motion" UseMotion "xsc_motion_psf" None false {
        /// Use them.
        enabled: bool => "" [0, 1];
    }
    /// Sets how sources are matched to stars.
    66 "solver.matching" MatchStars "xsc_pattern_matching" None true {
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
    80 "requirements.horizontal_location" RequireHorizontalLocation "xsc_filter_hor_location" None true {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Greatest distance.
        radius_deg: f64 => "deg" [0.1, 180];
    }
    /// Requires the horizontal roll to lie in a range.
    81 "requirements.horizontal_roll" RequireHorizontalRoll "xsc_filter_hor_roll" None true {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Lower end.
        min_deg: f64 => "deg" [-180, 180];
        /// Upper end.
        max_deg: f64 => "deg" [-180, 180];
    }
    /// Requires the elevation to lie in a range.
    82 "requirements.elevation" RequireElevation "xsc_filter_el" None true {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Lower end.
        min_deg: f64 => "deg" [-90, 90];
        /// Upper end.
        max_deg: f64 => "deg" [-90, 90];
    }
    /// Requires solutions to lie near the flight computer's estimate, on the sky.
    83 "requirements.equatorial_location" RequireEquatorialLocation "xsc_filter_eq_location" None true {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Greatest distance.
        radius_deg: f64 => "deg" [0.1, 180];
    }
    /// Requires the roll to lie in a range.
    84 "requirements.equatorial_roll" RequireEquatorialRoll "" None true {
        /// Require it.
        enabled: bool => "" [0, 1];
        /// Lower end.
        min_deg: f64 => "deg" [-180, 180];
        /// Upper end.
        max_deg: f64 => "deg" [-180, 180];
    }
    /// Sets what a solution must be like to be served.
    85 "requirements.matching" RequireMatching "xsc_filter_matching" None true {
        /// Greatest σ of the pointing.
        pointing_error_max_arcsec: f64 => "arcsec" [0.1, 200];
        /// Greatest rms residual.
        fit_error_max_px: f64 => "px" [0.1, 2000];
        /// Fewest matched sources.
        min_matched: u32 => "" [3, 20];
    }
}

/// Why numbers or words are no command.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CommandError {
    /// No command has this code.
    #[error("no command has the code {0}")]
    UnknownCode(u8),
    /// No command has this name.
    #[error("no command is called '{name}'{hint}")]
    UnknownName {
        /// As given.
        name: String,
        /// What may have been meant.
        hint: String,
    },
    /// Too few or too many values.
    #[error("{name} takes {wanted} values ({parameters}), {got} were given")]
    Count {
        /// The command.
        name: &'static str,
        /// How many it takes.
        wanted: usize,
        /// Their names.
        parameters: String,
        /// How many came.
        got: usize,
    },
    /// A value that may not be.
    #[error("{name}: {parameter} = {value}, expected {expected}")]
    OutOfRange {
        /// The command.
        name: &'static str,
        /// The value's name.
        parameter: &'static str,
        /// As given.
        value: String,
        /// What is allowed.
        expected: String,
    },
}

impl Definition {
    /// Every command, in the order of the codes.
    pub fn all() -> &'static [Self] {
        static ALL: std::sync::LazyLock<Vec<Definition>> = std::sync::LazyLock::new(all);
        &ALL
    }

    /// The one with a code.
    pub fn of_code(code: u8) -> Option<&'static Self> {
        Self::all().iter().find(|definition| definition.code == code)
    }

    /// The one with a name.
    pub fn of_name(name: &str) -> Option<&'static Self> {
        Self::all().iter().find(|definition| definition.name == name)
    }

    /// The command as it is written: its name and what it takes.
    pub fn usage(&self) -> String {
        let names = self.parameters.iter().map(|parameter| format!(" <{}>", parameter.name));
        std::iter::once(self.name.to_owned()).chain(names).collect()
    }

    fn count_error(&self, got: usize) -> CommandError {
        let parameters = self.parameters.iter().map(|parameter| parameter.name).collect::<Vec<_>>().join(", ");
        CommandError::Count { name: self.name, wanted: self.parameters.len(), parameters, got }
    }

    fn check(&self, numbers: &[f64]) -> Result<Command, CommandError> {
        for (parameter, number) in self.parameters.iter().zip(numbers) {
            if !parameter.allows(*number) {
                return Err(CommandError::OutOfRange {
                    name: self.name,
                    parameter: parameter.name,
                    value: number.to_string(),
                    expected: parameter.expected(),
                });
            }
        }
        Command::from_checked(self.code, numbers).ok_or(CommandError::UnknownCode(self.code))
    }
}

impl Command {
    /// What is known of it.
    ///
    /// # Errors
    /// Never for a command of this program: every code has its definition, which a test holds.
    pub fn definition(&self) -> Result<&'static Definition, CommandError> {
        Definition::of_code(self.code()).ok_or(CommandError::UnknownCode(self.code()))
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.definition().map_or("", |definition| definition.name)
    }

    /// From the wire's code and values; values that the command does not have must be 0.
    ///
    /// # Errors
    /// See [`CommandError`].
    pub fn from_wire(code: u8, values: &[f64; MAX_VALUES]) -> Result<Self, CommandError> {
        let definition = Definition::of_code(code).ok_or(CommandError::UnknownCode(code))?;
        let (own, rest) = values.split_at_checked(definition.parameters.len()).unwrap_or((values, &[]));
        if let Some(past) = rest.iter().rposition(|value| *value != 0.0) {
            return Err(definition.count_error(own.len() + past + 1));
        }
        definition.check(own)
    }

    /// Its values as the wire has them, filled up with zeros.
    pub fn wire_values(&self) -> [f64; MAX_VALUES] {
        let mut values = [0.0; MAX_VALUES];
        values.iter_mut().zip(self.numbers()).for_each(|(place, number)| *place = number);
        values
    }

    /// Reads a command as people write it: its name and its values, with spaces between.
    ///
    /// # Errors
    /// See [`CommandError`].
    pub fn parse(text: &str) -> Result<Self, CommandError> {
        let mut words = text.split_whitespace();
        let name = words.next().unwrap_or_default();
        let definition = Definition::of_name(name).ok_or_else(|| unknown(name))?;
        let words: Vec<&str> = words.collect();
        if words.len() != definition.parameters.len() {
            return Err(definition.count_error(words.len()));
        }
        let mut numbers = Vec::with_capacity(words.len());
        for (parameter, word) in definition.parameters.iter().zip(words) {
            numbers.push(parameter.read(word).ok_or_else(|| CommandError::OutOfRange {
                name: definition.name,
                parameter: parameter.name,
                value: word.to_owned(),
                expected: parameter.expected(),
            })?);
        }
        definition.check(&numbers)
    }
}

/// The command as people write it; [`Command::parse`] reads it back.
impl std::fmt::Display for Command {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())?;
        let parameters = self.definition().map_or(&[][..], |definition| &definition.parameters);
        parameters.iter().zip(self.numbers()).try_for_each(|(parameter, number)| write!(f, " {}", parameter.word(number)))
    }
}

/// A name that is none; with those of the same actor as a hint.
fn unknown(name: &str) -> CommandError {
    let actor = name.split('.').next().unwrap_or_default();
    let near: Vec<&str> =
        Definition::all().iter().map(|known| known.name).filter(|known| known.split('.').next() == Some(actor)).collect();
    let hint = if near.is_empty() {
        let mut actors: Vec<&str> = Definition::all().iter().filter_map(|known| known.name.split('.').next()).collect();
        actors.dedup();
        format!("; names begin with one of {}", actors.join(", "))
    } else {
        format!("; there are {}", near.join(", "))
    };
    CommandError::UnknownName { name: name.to_owned(), hint }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::value::Shape;
    use std::collections::HashSet;

    /// The least and the greatest command of a definition.
    fn ends(definition: &Definition) -> [Command; 2] {
        [|p: &Parameter| p.low, |p: &Parameter| p.high].map(|end| {
            let mut values = [0.0; MAX_VALUES];
            values.iter_mut().zip(&definition.parameters).for_each(|(place, parameter)| *place = end(parameter));
            Command::from_wire(definition.code, &values).unwrap()
        })
    }

    #[test]
    fn codes_and_names_are_given_once_and_values_fit_the_wire() {
        let (mut codes, mut names) = (HashSet::new(), HashSet::new());
        for definition in Definition::all() {
            assert!(codes.insert(definition.code) && definition.code > 0 && names.insert(definition.name), "{}", definition.name);
            assert!(definition.parameters.len() <= MAX_VALUES && !definition.meaning.is_empty());
            for parameter in &definition.parameters {
                assert!(parameter.low < parameter.high, "{} {}", definition.name, parameter.name);
            }
        }
    }

    #[test]
    fn every_command_reads_back_from_its_numbers_and_from_its_words() {
        for definition in Definition::all() {
            for command in ends(definition) {
                assert_eq!(command.definition().unwrap().code, definition.code);
                assert_eq!(Command::from_wire(command.code(), &command.wire_values()), Ok(command));
                assert_eq!(Command::parse(&command.to_string()), Ok(command), "{command}");
            }
        }
    }

    #[test]
    fn every_value_is_refused_beyond_both_ends_of_its_range() {
        let mut refused = 0;
        for definition in Definition::all() {
            for (place, parameter) in definition.parameters.iter().enumerate() {
                let beyond = (parameter.high - parameter.low).max(1.0) * 1e-3;
                let beyond = if parameter.shape == Shape::Real { beyond } else { 1.0 };
                for wrong in [parameter.low - beyond, parameter.high + beyond, f64::NAN, f64::INFINITY] {
                    let mut values = ends(definition)[0].wire_values();
                    values[place] = wrong;
                    let error = Command::from_wire(definition.code, &values).unwrap_err();
                    assert!(matches!(&error, CommandError::OutOfRange { parameter: named, .. } if *named == parameter.name));
                    refused += 1;
                }
            }
        }
        assert!(refused > 150);
    }

    #[test]
    fn whole_numbers_are_whole_and_values_that_a_command_does_not_have_are_refused() {
        let mut values = [0.0; MAX_VALUES];
        values[0] = 3030.5;
        assert!(matches!(Command::from_wire(23, &values), Err(CommandError::OutOfRange { .. })));
        values = [3030.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert!(matches!(Command::from_wire(23, &values), Err(CommandError::Count { got: 3, wanted: 1, .. })));
        assert_eq!(Command::from_wire(200, &values), Err(CommandError::UnknownCode(200)));
    }

    #[test]
    fn what_people_mistype_is_answered_with_what_was_expected() {
        let cases = [
            ("lens.set_focus", "lens.set_focus takes 1 values (position_counts), 0 were given"),
            ("lens.set_focus x", "lens.set_focus: position_counts = x, expected a whole number from 0 to 65535"),
            ("lens.set_focus 70000", "lens.set_focus: position_counts = 70000, expected a whole number from 0 to 65535"),
            ("solver.abort now", "solver.abort takes 0 values (), 1 were given"),
            ("focus.set_display never", "focus.set_display: show = never, expected auto, on, off"),
        ];
        for (text, wanted) in cases {
            assert_eq!(Command::parse(text).unwrap_err().to_string(), wanted);
        }
        assert!(Command::parse("lens.focus 3").unwrap_err().to_string().contains("lens.set_focus"));
        assert!(Command::parse("lense").unwrap_err().to_string().contains("requirements"));
        assert_eq!(Command::parse(" solver.mask  on 1 2 3 ").unwrap().to_string(), "solver.mask 1 1 2 3");
    }
}
