//! The last frames: their outcomes, and the pixels of the newest, as far as there is memory for them.

use crate::display::{FixedSources, FrameView, Geometry};
use crate::image::{Frame, ImageCounter};
use crate::service::state::Finished;
use crate::settings::{DisplaySettings, Settings};
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;

/// A frame that ended, with its pixels where they are still there.
#[derive(Debug, Clone)]
pub struct Past {
    /// Its outcome.
    pub finished: Arc<Finished>,
    /// Its pixels.
    pub frame: Option<Arc<Frame>>,
}

impl Past {
    /// Its number.
    pub fn image(&self) -> ImageCounter {
        self.finished.outcome.stamp.image
    }

    fn geometry(&self, settings: &Settings) -> Option<Geometry> {
        let picture = self.finished.picture?;
        Some(Geometry::new(picture.width, picture.height, picture.rows, settings.camera.mirrored))
    }

    /// All that is shown of it under the settings in force.
    pub fn view(&self, settings: &Settings) -> FrameView {
        FrameView::new(&self.finished.outcome, &self.finished.report, self.geometry(settings), settings)
    }

    fn bytes(&self) -> usize {
        self.frame.as_ref().map_or(0, |frame| frame.pixels.len() * size_of::<u16>())
    }
}

/// A frame in the strip.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Entry {
    /// Its number.
    pub image: u32,
    /// How it ended.
    pub reason: String,
    /// Sources matched.
    pub matched: usize,
    /// Sources found.
    pub found: usize,
    /// Whether its pixels are still there.
    pub pixels: bool,
}

/// The last frames.
#[derive(Debug)]
pub struct History {
    frames: VecDeque<Past>,
    most: usize,
    most_bytes: usize,
    /// Numbers that were never shown here: of frames that were skipped, or came too fast.
    passed_over: u64,
    fixed: FixedSources,
}

impl History {
    /// As long as the settings say.
    pub fn new(settings: &DisplaySettings) -> Self {
        let (most, mib) = (settings.history_frames, settings.history_mib);
        Self {
            frames: VecDeque::new(),
            most: most as usize,
            most_bytes: (mib as usize) << 20,
            passed_over: 0,
            fixed: FixedSources::default(),
        }
    }

    /// Takes the last frame that ended, with the pixels that were shown last; whether it is a new one.
    pub fn take(&mut self, finished: &Arc<Finished>, shown: Option<&Arc<Frame>>, settings: &Settings) -> bool {
        if self.frames.back().is_some_and(|last| Arc::ptr_eq(&last.finished, finished)) {
            return false;
        }
        let image = finished.outcome.stamp.image;
        if let Some(last) = self.frames.back() {
            self.passed_over += u64::from(image.0.wrapping_sub(last.image().0).saturating_sub(1).min(u32::MAX / 2));
        }
        let frame = shown.filter(|frame| frame.stamp.image == image).cloned();
        let past = Past { finished: Arc::clone(finished), frame };
        if let Some(geometry) = past.geometry(settings) {
            self.fixed.take(&finished.outcome, &geometry);
        }
        self.frames.push_back(past);
        if self.frames.len() > self.most {
            self.frames.pop_front();
        }
        self.let_pixels_go();
        true
    }

    /// Keeps the pixels of the newest frames that fit, and the last ones whatever their size.
    fn let_pixels_go(&mut self) {
        let mut taken = 0;
        for (age, past) in self.frames.iter_mut().rev().enumerate() {
            taken += past.bytes();
            if age > 0 && taken > self.most_bytes {
                past.frame = None;
            }
        }
    }

    /// The last frame, or the one of a number.
    pub fn get(&self, image: Option<u32>) -> Option<Past> {
        match image {
            None => self.frames.back().cloned(),
            Some(image) => self.frames.iter().rev().find(|past| past.image().0 == image).cloned(),
        }
    }

    /// All that is shown of a frame; of the last one with the mask that is proposed.
    pub fn view(&self, image: Option<u32>, settings: &Settings) -> Option<FrameView> {
        let past = self.get(image)?;
        let mut view = past.view(settings);
        view.pixels = past.frame.is_some();
        if self.frames.back().is_some_and(|last| last.image() == past.image())
            && let Some(geometry) = &view.geometry
        {
            view.proposal = self.fixed.propose(&settings.solver.mask, geometry);
        }
        Some(view)
    }

    /// The strip, oldest first, and how many numbers were passed over.
    pub fn strip(&self) -> (Vec<Entry>, u64) {
        let entry = |past: &Past| {
            let report = &past.finished.report;
            Entry {
                image: past.image().0,
                reason: report.reason.to_string(),
                matched: report.matched,
                found: report.sources_found,
                pixels: past.frame.is_some(),
            }
        };
        (self.frames.iter().map(entry).collect(), self.passed_over)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Stamp;
    use crate::sky::RowOrder;
    use crate::solve::{Outcome, Reason};
    use tokio::time::Instant;

    fn settings() -> Settings {
        Settings::flight().unwrap()
    }

    fn ended(image: u32) -> Arc<Finished> {
        let stamp = Stamp { image: ImageCounter(image), ..Stamp::default() };
        Arc::new(Finished::without_stars(Outcome::unsolved(stamp, Reason::NoMatch, ""), Instant::now()))
    }

    fn pixels(image: u32, side: usize) -> Arc<Frame> {
        let mut frame = Frame::new(side, side, vec![7; side * side], RowOrder::TopFirst).unwrap();
        frame.stamp.image = ImageCounter(image);
        Arc::new(frame)
    }

    #[test]
    fn every_number_is_in_the_strip_or_counted_as_passed_over() {
        let mut history = History::new(&DisplaySettings { history_frames: 3, ..settings().display });
        for image in [2, 3, 7, 8] {
            assert!(history.take(&ended(image), None, &settings()));
        }
        let (strip, passed_over) = history.strip();
        assert_eq!((strip.iter().map(|entry| entry.image).collect::<Vec<_>>(), passed_over), (vec![3, 7, 8], 3));
    }

    #[test]
    fn the_same_outcome_is_taken_once_and_pixels_of_another_frame_are_not_shown_for_it() {
        let mut history = History::new(&settings().display);
        let first = ended(2);
        assert!(history.take(&first, Some(&pixels(3, 4)), &settings()));
        assert!(!history.take(&first, Some(&pixels(2, 4)), &settings()));
        assert!(history.get(None).unwrap().frame.is_none());
        assert!(history.take(&ended(3), Some(&pixels(3, 4)), &settings()));
        assert!(history.get(Some(3)).unwrap().frame.is_some() && history.get(Some(4)).is_none());
    }

    #[test]
    fn pixels_of_old_frames_go_when_there_is_no_room_and_the_last_stay_whatever_their_size() {
        let mut history = History::new(&DisplaySettings { history_mib: 1, ..settings().display });
        // Half a MiB each.
        for image in 0..4 {
            history.take(&ended(image), Some(&pixels(image, 512)), &settings());
        }
        assert_eq!([0, 3].map(|image| history.view(Some(image), &settings()).unwrap().pixels), [false, true]);
        let there = |history: &History| history.strip().0.iter().map(|entry| entry.pixels).collect::<Vec<_>>();
        assert_eq!(there(&history), [false, false, true, true]);
        history.take(&ended(4), Some(&pixels(4, 2048)), &settings());
        assert_eq!(there(&history), [false, false, false, false, true]);
    }
}
