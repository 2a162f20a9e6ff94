//! What an update says of what makes the camera expose. From version 3 on.

use super::code::codes;
use super::element::body;
use super::{Coded, Maybe, U32Le};
use crate::image::ExposedBy;

codes!(ExposedBy {
    1 Asked "asked",
    2 Trigger "trigger",
    3 Itself "itself",
});

body! {
    /// What makes the camera expose.
    pub struct Triggers {
        /// What makes it expose now: itself, where no trigger came for so long as the camera's settings say, and until one comes.
        exposing: Coded<ExposedBy> => "";
        /// Time since the last image that a trigger made; unknown where none did since the camera's start.
        last_triggered_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Times since the camera's start that triggers stayed away for so long.
        triggers_stayed_away: U32Le => "";
        /// What made the camera expose the last image.
        image_exposed_by: Maybe<Coded<ExposedBy>> => "";
    }
}
