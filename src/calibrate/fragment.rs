//! A calibration as a settings fragment that says where it came from, and what keeps one from being put in force.

use super::{Lens, Offset};
use crate::settings::Settings;
use crate::sky::ARCSEC;
use std::fmt::Write;

/// What its last line begins with; the checksum of everything before it follows.
const SEAL: &str = "# crc32 of all above: ";
/// The setting that names the list of hot pixels.
const LIST_KEY: &str = "bad_pixels_file = ";
/// Room about the plate scale beyond its scatter, fraction: what cold and focus change.
const SCALE_ROOM: f64 = 5e-3;
/// So many times the scatter from frame to frame goes to that.
const SCATTER_ROOM: f64 = 5.0;
/// Least σ of the distortion that is given away: what focus changes of it.
const LEAST_SIGMA_K1: f64 = 1e-4;
/// The same of the axis, px.
const LEAST_SIGMA_AXIS_PX: f64 = 1.0;
/// From one calibration to the next the plate scale changes by less than this, fraction.
const MOST_SCALE_CHANGE: f64 = 1e-2;
/// The same of k1.
const MOST_K1_CHANGE: f64 = 5e-3;
/// More bad pixels than this, fraction of the sensor, are no list of a sensor that may fly.
const MOST_BAD: f64 = 1e-2;

/// What was found, and from what.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Name of the camera.
    pub camera: String,
    /// When it was made, UTC.
    pub made: String,
    /// From what: directory, images, how many of them were solved.
    pub source: String,
    /// The lens.
    pub lens: Lens,
    /// Half the diagonal of its pictures, px.
    pub half_diagonal_px: f64,
    /// How many hot pixels were found in how many frames, and the file with their list; `None` where they were not looked for.
    pub hot_pixels: Option<(usize, usize, String)>,
    /// Why they were not, if that is to be told.
    pub remark: Option<String>,
    /// From what the second camera's offset comes, and the offset.
    pub other: Option<(String, Offset)>,
}

/// Why a text is no calibration.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FragmentError {
    /// It does not end in a checksum.
    #[error("has no checksum in its last line, expected a calibration as `stars calibrate --out` writes it")]
    NoSeal,
    /// The checksum is another one.
    #[error("was changed or torn since it was written: its checksum is not that of its text")]
    Damaged,
    /// It sets something else.
    #[error("sets '{0}', which no calibration does")]
    Foreign(String),
}

/// What keeps a calibration from being put in force.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GuardError {
    /// Outside of what the files allow.
    #[error("its plate scale of {0:.4}″/px is outside the range of the camera's own files, {1} to {2}")]
    Scale(f64, f64, f64),
    /// Too far from that in force.
    #[error("its plate scale differs by {0:.2} % from that of the calibration in force, expected at most {max} %", max = 100.0 * MOST_SCALE_CHANGE)]
    ScaleChange(f64),
    /// As above.
    #[error("its distortion differs by {0:.4} from that in force, expected at most {MOST_K1_CHANGE}")]
    DistortionChange(f64),
    /// Too many bad pixels.
    #[error("it has {0} bad pixels, expected at most {max} % of the sensor", max = 100.0 * MOST_BAD)]
    BadPixels(usize),
}

impl Calibration {
    /// What was found, a line each.
    pub fn words(&self) -> Vec<String> {
        let lens = &self.lens;
        let mut lines = vec![
            format!(
                "{} frames, {} stars matched, {} left out; χ² per degree of freedom {:.2}",
                lens.frames, lens.stars, lens.clipped, lens.chi2_per_dof
            ),
            format!(
                "plate scale {:.5} ± {:.5} arcsec/px at the centre; from frame to frame it changes by {:.4} %",
                lens.platescale / ARCSEC,
                lens.sigma_platescale / ARCSEC,
                100.0 * lens.scatter
            ),
        ];
        let corner = lens.k1_found * self.half_diagonal_px;
        let found = format!("k1 = {:+.6} ± {:.6}, {corner:+.2} px in the corners", lens.k1_found, lens.sigma_k1);
        lines.push(if lens.warranted {
            format!(
                "distortion is warranted: {found}, about {:+.1} ± {:.1} px left and {:+.1} ± {:.1} px up of the centre",
                lens.axis.0, lens.sigma_axis.0, lens.axis.1, lens.sigma_axis.1
            )
        } else {
            format!("distortion is not warranted: {found}")
        });
        match (&self.hot_pixels, &self.remark) {
            (Some((count, frames, _)), _) => lines.push(format!("{count} hot pixels in {frames} frames")),
            (None, Some(remark)) => lines.push(format!("hot pixels were not looked for: {remark}")),
            (None, None) => {}
        }
        if let Some((source, offset)) = &self.other {
            let sigma = offset.sigmas / ARCSEC;
            // The boresight goes up and down by turns about left, and left and right by those about up.
            lines.push(format!(
                "the camera of {source} is turned by {:+.3} ± {:.3}″ left, {:+.3} ± {:.3}″ up, {:+.2} ± {:.2}″ about the boresight ({} pairs)",
                offset.left / ARCSEC,
                sigma.y,
                offset.up / ARCSEC,
                sigma.x,
                offset.roll / ARCSEC,
                sigma.z,
                offset.pairs
            ));
        }
        lines
    }

    /// The settings, sealed.
    pub fn text(&self) -> String {
        let lens = &self.lens;
        let scale = lens.platescale / ARCSEC;
        let room = SCALE_ROOM + SCATTER_ROOM * lens.scatter;
        let sigma_k1 = if lens.warranted { lens.sigma_k1 } else { lens.sigma_k1.hypot(lens.k1_found) };
        let sigma_axis = lens.sigma_axis.0.max(lens.sigma_axis.1).max(LEAST_SIGMA_AXIS_PX);
        let mut text = format!("# Calibration of the camera \"{}\", made {}\n# from {}\n", self.camera, self.made, self.source);
        self.words().iter().for_each(|line| text += &format!("# {line}\n"));
        let digits = |value: f64, digits: i32| (value * 10f64.powi(digits)).round() / 10f64.powi(digits);
        // Writing into a string cannot fail.
        let _ = write!(
            text,
            "\n[solver.matching]\nplatescale_min_arcsec_px = {:?}\nplatescale_max_arcsec_px = {:?}\n\n[solver.fit]\n\
             distortion_k1 = {:?}\ndistortion_sigma = {:?}\n",
            digits(scale * (1.0 - room), 5),
            digits(scale * (1.0 + room), 5),
            digits(if lens.warranted { lens.k1 } else { 0.0 }, 7),
            digits(sigma_k1.max(LEAST_SIGMA_K1), 7),
        );
        if lens.warranted {
            let _ = write!(
                text,
                "axis_left_px = {:?}\naxis_up_px = {:?}\naxis_sigma_px = {:?}\n",
                digits(lens.axis.0, 2),
                digits(lens.axis.1, 2),
                digits(sigma_axis, 2)
            );
        }
        if let Some((_, _, list)) = &self.hot_pixels {
            let _ = write!(text, "\n[solver.sources]\n{LIST_KEY}{}\n", quoted(list));
        }
        seal(&text)
    }
}

/// A list of bad pixels as `solver.sources.bad_pixels_file` has it; `header` says where it came from.
pub fn list_text(header: &str, pixels: &[(usize, usize)]) -> String {
    let mut text = format!("# {header}\n# column and row, from 0\n");
    pixels.iter().for_each(|(x, y)| text += &format!("{x} {y}\n"));
    text
}

/// A text with its checksum in the last line.
pub fn seal(text: &str) -> String {
    format!("{text}\n{SEAL}{:08x}\n", crc32fast::hash(text.as_bytes()))
}

/// The text before the seal, which is right; only what a calibration may set is set.
///
/// # Errors
/// Where it is not as it was written, or sets anything else.
pub fn sealed(text: &str) -> Result<&str, FragmentError> {
    let (body, sum) = text.trim_end().rsplit_once(SEAL).ok_or(FragmentError::NoSeal)?;
    let body = body.strip_suffix('\n').ok_or(FragmentError::Damaged)?;
    if u32::from_str_radix(sum, 16) != Ok(crc32fast::hash(body.as_bytes())) {
        return Err(FragmentError::Damaged);
    }
    const MAY: [&str; 8] = [
        "platescale_min_arcsec_px",
        "platescale_max_arcsec_px",
        "distortion_k1",
        "distortion_sigma",
        "axis_left_px",
        "axis_up_px",
        "axis_sigma_px",
        "bad_pixels_file",
    ];
    let assigned = body.lines().filter(|line| !line.starts_with(['#', '['])).filter_map(|line| line.split_once('='));
    match assigned.map(|(key, _)| key.trim()).find(|key| !MAY.contains(key)) {
        Some(key) => Err(FragmentError::Foreign(key.to_owned())),
        None => Ok(body),
    }
}

/// The file of the list of bad pixels that a calibration names.
pub fn list_of(text: &str) -> Option<String> {
    let named = text.lines().find_map(|line| line.strip_prefix(LIST_KEY))?;
    toml::from_str::<toml::Table>(&format!("{LIST_KEY}{named}")).ok()?.values().next()?.as_str().map(str::to_owned)
}

/// A calibration that names another file for its list, sealed anew.
pub fn with_list(body: &str, list: &str) -> String {
    let line = |line: &str| if line.starts_with(LIST_KEY) { format!("{LIST_KEY}{}", quoted(list)) } else { line.to_owned() };
    let lines: Vec<String> = body.lines().map(line).collect();
    seal(&(lines.join("\n") + "\n"))
}

fn quoted(text: &str) -> String {
    toml::Value::from(text).to_string()
}

/// Whether settings with a calibration may be put in force. `files`: those without any; `in_force`: those with the calibration that there
/// is, if there is one.
///
/// # Errors
/// What is outside the camera's own files, or changes more than a lens and a sensor do.
pub fn guard(files: &Settings, in_force: Option<&Settings>, new: &Settings, bad_pixels: usize) -> Result<(), GuardError> {
    let range = |settings: &Settings| {
        let matching = &settings.solver.matching;
        (matching.platescale_min_arcsec_px, matching.platescale_max_arcsec_px)
    };
    let middle = |settings: &Settings| 0.5 * (range(settings).0 + range(settings).1);
    let (low, high) = range(files);
    let scale = middle(new);
    if !(low..=high).contains(&scale) {
        return Err(GuardError::Scale(scale, low, high));
    }
    if let Some(in_force) = in_force {
        let change = scale / middle(in_force) - 1.0;
        if change.abs() > MOST_SCALE_CHANGE {
            return Err(GuardError::ScaleChange(100.0 * change));
        }
        let change = new.solver.fit.distortion_k1 - in_force.solver.fit.distortion_k1;
        if change.abs() > MOST_K1_CHANGE {
            return Err(GuardError::DistortionChange(change));
        }
    }
    let most = MOST_BAD * f64::from(files.camera.width_px) * f64::from(files.camera.height_px);
    if bad_pixels as f64 > most { Err(GuardError::BadPixels(bad_pixels)) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Layers;

    fn calibration(warranted: bool) -> Calibration {
        let lens = Lens {
            frames: 198,
            stars: 5123,
            clipped: 7,
            platescale: 9.4 * ARCSEC,
            sigma_platescale: 2e-5 * ARCSEC,
            scatter: 1e-4,
            k1: if warranted { -9e-4 } else { 0.0 },
            k1_found: -9e-4,
            sigma_k1: 1.2e-5,
            warranted,
            axis: (12.3, -4.5),
            sigma_axis: (2.0, 2.5),
            chi2_per_dof: 1.1,
            attitudes: Vec::new(),
        };
        Calibration {
            camera: "xsc0".into(),
            made: "2013-01-01T00:00:00Z".into(),
            source: "records: 198 of 200 images".into(),
            lens,
            half_diagonal_px: 923.0,
            hot_pixels: Some((1234, 200, "state of \"it\"/bad.txt".into())),
            remark: None,
            other: None,
        }
    }

    #[test]
    fn its_text_is_settings_that_load_and_say_where_they_came_from() {
        let text = calibration(true).text();
        assert!(text.contains("from records: 198 of 200 images") && text.contains("1234 hot pixels"), "{text}");
        assert_eq!(list_of(&text).as_deref(), Some("state of \"it\"/bad.txt"));
        let moved = with_list(sealed(&text).unwrap(), "elsewhere");
        assert_eq!(list_of(sealed(&moved).unwrap()).as_deref(), Some("elsewhere"));
        let settings = Layers::embedded().calibrated("cal.toml", &text).load().unwrap().settings;
        assert_eq!((settings.solver.fit.distortion_k1, settings.solver.fit.axis_left_px), (-9e-4, 12.3));
        let matching = &settings.solver.matching;
        assert!(matching.platescale_min_arcsec_px > 9.3 && matching.platescale_max_arcsec_px < 9.5);
        let plain = Layers::embedded().calibrated("cal.toml", calibration(false).text()).load().unwrap().settings;
        assert_eq!((plain.solver.fit.distortion_k1, plain.solver.fit.axis_left_px), (0.0, 0.0));
        assert!(plain.solver.fit.distortion_sigma > 8e-4, "what was found and not believed stays possible");
    }

    #[test]
    fn what_was_changed_torn_or_is_something_else_is_refused() {
        let text = calibration(true).text();
        assert_eq!(sealed(&text.replace("9.4", "9.5")), Err(FragmentError::Damaged));
        assert_eq!(sealed(&text[..text.len() / 2]), Err(FragmentError::NoSeal));
        assert_eq!(sealed(""), Err(FragmentError::NoSeal));
        let foreign = seal("[solver]\nenabled = false\n");
        assert_eq!(sealed(&foreign), Err(FragmentError::Foreign("enabled".into())));
    }

    #[test]
    fn a_mad_change_is_refused() {
        let files = Settings::flight().unwrap();
        let with = |scale: f64, k1: f64| {
            let mut settings = files.clone();
            let matching = &mut settings.solver.matching;
            (matching.platescale_min_arcsec_px, matching.platescale_max_arcsec_px) = (scale - 0.02, scale + 0.02);
            settings.solver.fit.distortion_k1 = k1;
            settings
        };
        assert_eq!(guard(&files, None, &with(9.4, 1e-3), 1500), Ok(()));
        assert!(matches!(guard(&files, None, &with(10.4, 0.0), 0), Err(GuardError::Scale(..))));
        assert_eq!(guard(&files, Some(&with(9.45, 0.0)), &with(9.4, 1e-3), 0), Ok(()));
        assert!(matches!(guard(&files, Some(&with(9.6, 0.0)), &with(9.4, 0.0), 0), Err(GuardError::ScaleChange(_))));
        assert!(matches!(guard(&files, Some(&with(9.4, 3e-3)), &with(9.4, -3e-3), 0), Err(GuardError::DistortionChange(_))));
        assert!(matches!(guard(&files, None, &with(9.4, 0.0), 20_000), Err(GuardError::BadPixels(20_000))));
    }
}
