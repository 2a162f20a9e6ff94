//! Codes: closed lists as one byte, in which 0 is never valid.

use super::layout::{About, Form, Table};
use super::{Element, Maybe};
use crate::sky::ClockQuality;
use crate::solve::{Cause, Reason, SearchMode};
use serde::{Deserialize, Serialize};
use std::marker::PhantomData;

/// A closed list that goes over the wire as a code: the place in the list, counted from 1.
pub trait Code: Copy + PartialEq + std::fmt::Debug + 'static {
    /// Every value, in the order of the codes.
    const ALL: &'static [Self];
    /// The names of the values, in the same order.
    const NAMES: &'static [&'static str];
    /// The code of this value.
    fn code(self) -> u8;
}

/// A code as it stands in a body.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Coded<T> {
    code: u8,
    #[serde(skip)]
    list: PhantomData<T>,
}

impl<T: Code> Coded<T> {
    /// The value; `None` only for a code that is not in the list, which no decoded message has where it is known.
    pub fn get(&self) -> Option<T> {
        let place = usize::from(self.code).checked_sub(1)?;
        T::ALL.get(place).copied()
    }
}

impl<T: Code> From<T> for Coded<T> {
    fn from(value: T) -> Self {
        Self { code: value.code(), list: PhantomData }
    }
}

impl<T: Code> Default for Coded<T> {
    /// The first of the list, so that no body begins its life undecodable.
    fn default() -> Self {
        Self { code: 1, list: PhantomData }
    }
}

impl<T: Code> Element for Coded<T> {
    const SIZE: usize = 1;

    fn describe(table: &mut Table, about: &About) {
        table.push(about, Form::Code(T::NAMES), 1);
    }
}

impl<T: Code> Maybe<Coded<T>> {
    /// The value, where it is known.
    pub fn value(&self) -> Option<T> {
        self.get().and_then(Coded::get)
    }
}

/// Gives a closed list its codes and names. A value that is left out does not compile.
macro_rules! codes {
    ($type:ident { $( $code:literal $value:ident $name:literal, )+ }) => {
        impl $crate::wire::Code for $type {
            const ALL: &'static [Self] = &[$( $type::$value ),+];
            const NAMES: &'static [&'static str] = &[$( $name ),+];
            fn code(self) -> u8 {
                match self {
                    $( $type::$value => $code ),+
                }
            }
        }
    };
}
pub(super) use codes;

codes!(Reason {
    1 Solved "solved",
    2 Saturated "saturated",
    3 TooBright "too_bright",
    4 NoContrast "no_contrast",
    5 TooFewSources "too_few_sources",
    6 NoMatch "no_match",
    7 Undecided "undecided",
    8 Requirement "requirement",
    9 TimedOut "timed_out",
    10 Aborted "aborted",
    11 Disabled "disabled",
    12 Skipped "skipped",
    13 Unreadable "unreadable",
    14 Failed "failed",
});

codes!(Cause {
    1 Overexposed "overexposed",
    2 Saturated "saturated",
    3 NoContrast "no_contrast",
    4 OutOfFocus "out_of_focus",
    5 Trailed "trailed",
    6 Clouds "clouds",
    7 TooFewStars "too_few_stars",
    8 TooManyArtefacts "too_many_artefacts",
    9 WrongPlatescale "wrong_platescale",
    10 Mirrored "mirrored",
    11 WrongPrior "wrong_prior",
    12 LensCovered "lens_covered",
});

codes!(SearchMode {
    1 Normal "normal",
    2 Robust "robust",
    3 Motion "motion",
});

codes!(ClockQuality {
    1 Unset "unset",
    2 FreeRunning "free_running",
    3 Synchronised "synchronised",
    4 FlightComputer "flight_computer",
    5 Chrony "chrony",
    6 Ptp "ptp",
});

#[cfg(test)]
mod tests {
    use super::*;

    fn agrees<T: Code + Serialize>() {
        assert_eq!(T::ALL.len(), T::NAMES.len());
        for (place, (value, name)) in T::ALL.iter().zip(T::NAMES).enumerate() {
            assert_eq!(usize::from(value.code()), place + 1, "{name}");
            assert_eq!(serde_json::to_value(value).unwrap(), *name);
            assert_eq!(Coded::from(*value).get(), Some(*value));
        }
    }

    #[test]
    fn codes_count_from_one_in_the_order_of_the_list_and_bear_the_names_of_the_json() {
        agrees::<Reason>();
        agrees::<Cause>();
        agrees::<SearchMode>();
        agrees::<ClockQuality>();
        agrees::<crate::image::ExposedBy>();
        agrees::<crate::wire::Actor>();
        agrees::<crate::wire::LastEnd>();
        agrees::<crate::wire::Found>();
        agrees::<crate::wire::Wanted>();
        agrees::<crate::wire::ImageForm>();
        agrees::<crate::wire::NoImage>();
    }

    #[test]
    fn zero_is_no_value() {
        let zero: Coded<Reason> = postcard::from_bytes(&[0]).unwrap();
        assert_eq!(zero.get(), None);
    }
}
