//! From the state to what one flight computer of old is told.

use super::super::housekeeping::housekeeping;
use super::super::state::{Finished, State};
use super::super::update::camera;
use crate::wire::legacy::{ANSWER_BYTES, Answer};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// What one connection was told. Numbers that were told once stay until there are others, as they did in the program that flew.
#[derive(Debug, Default)]
pub struct Teller {
    answer: Answer,
    told: Option<Arc<Finished>>,
}

impl Teller {
    /// The next answer. An image that ended is told at least once, even where another is being solved by then; otherwise an image
    /// that is being solved hides the one before, as it did.
    pub fn answer(&mut self, state: &State, uptime: Duration) -> [u8; ANSWER_BYTES] {
        self.answer.note_camera(&camera(state), uptime.as_secs_f64());
        self.answer.note_housekeeping(&housekeeping(state, Instant::now()));
        let is_told = |finished: &Arc<Finished>| self.told.as_ref().is_some_and(|told| Arc::ptr_eq(told, finished));
        match (&state.latest, state.solving) {
            (Some(finished), Some(image)) if is_told(finished) => self.answer.note_begun(image),
            (Some(finished), _) => {
                let ideal_gain = state.settings.camera.ideal_gain_adu_per_e;
                // The dialect has no word for a simulation, and whoever reads it steers by it.
                self.answer.note_outcome(&finished.outcome, finished.picture, !state.simulated.camera, ideal_gain);
                self.told = Some(Arc::clone(finished));
            }
            (None, Some(image)) => self.answer.note_begun(image),
            (None, None) => {}
        }
        self.answer.pack()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Guard;
    use crate::image::{ImageCounter, Stamp};
    use crate::settings::{CameraKind, Settings};
    use crate::sky::{ARCSEC, Attitude, Mat3};
    use crate::solve::{Outcome, Reason, Solution};

    fn state(kind: CameraKind) -> State {
        let mut settings = Settings::flight().unwrap();
        settings.camera.kind = kind;
        State::new(Arc::new(settings), Guard::default())
    }

    fn solved(image: u32) -> Arc<Finished> {
        let solution = Solution {
            attitude: Attitude::from_angles(1.0, -0.5, 0.25),
            platescale: 9.44 * ARCSEC,
            k1: 0.0,
            axis: (0.0, 0.0),
            covariance: Mat3::identity() * ARCSEC * ARCSEC,
            sigma_platescale: 1e-3 * ARCSEC,
            rms_px: 0.2,
            chi2_per_dof: 1.1,
            matches: Vec::new(),
            false_probability_log10: -20.0,
            horizontal: None,
            epoch_yr: None,
            start: None,
            served: None,
        };
        let stamp = Stamp { image: ImageCounter(image), ..Stamp::default() };
        let outcome =
            Outcome { reason: Reason::Solved, solution: Some(solution), ..Outcome::unsolved(stamp, Reason::Solved, "") };
        Arc::new(Finished::without_stars(outcome, Instant::now()))
    }

    /// Image and validity as an answer says them.
    fn said(answer: &[u8; ANSWER_BYTES]) -> (i32, bool) {
        (i32::from_le_bytes(answer[14 * 8..14 * 8 + 4].try_into().unwrap()), answer[24 * 8] == 1)
    }

    #[tokio::test]
    async fn each_solution_is_told_once_at_least_and_then_gives_way_to_the_image_that_is_being_solved() {
        let mut state = state(CameraKind::Directory);
        let mut teller = Teller::default();
        let mut next = |state: &State| said(&teller.answer(state, Duration::from_secs(9)));
        assert_eq!(next(&state), (-1, false));
        state.solving = Some(ImageCounter(4));
        assert_eq!(next(&state), (4, false));
        state.latest = Some(solved(4));
        state.solving = Some(ImageCounter(5));
        assert_eq!(next(&state), (4, true));
        assert_eq!(next(&state), (5, false));
        state.solving = None;
        assert_eq!(next(&state), (4, true));
    }

    #[tokio::test]
    async fn no_solution_is_told_while_the_camera_is_simulated() {
        let mut state = state(CameraKind::Sky);
        state.latest = Some(solved(4));
        assert_eq!(said(&Teller::default().answer(&state, Duration::ZERO)), (4, false));
    }
}
