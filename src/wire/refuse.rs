//! `Refuse`: why a connection is about to be closed.

use super::code::codes;
use super::element::body;
use super::{Coded, PROTOCOL_CURRENT, PROTOCOL_MIN, Text};

/// Why a connection is refused or ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// The two ends have no version of the protocol in common.
    NoCommonVersion,
    /// The first message was no hello, or lacked its magic.
    NotAHello,
    /// Both ends are the same kind of thing.
    WrongRole,
    /// The address is not one that may connect.
    AddressNotAllowed,
    /// All places are taken.
    TooManyConnections,
    /// A newer connection of the same flight computer took its place.
    Replaced,
    /// What came could not be read.
    BadMessage,
    /// Nothing came for too long.
    Silent,
    /// The program ends.
    ShuttingDown,
}

codes!(Refusal {
    1 NoCommonVersion "no_common_version",
    2 NotAHello "not_a_hello",
    3 WrongRole "wrong_role",
    4 AddressNotAllowed "address_not_allowed",
    5 TooManyConnections "too_many_connections",
    6 Replaced "replaced",
    7 BadMessage "bad_message",
    8 Silent "silent",
    9 ShuttingDown "shutting_down",
});

body! {
    /// Last message before the sender closes the connection, where there is time for one.
    pub struct Refuse {
        /// Why.
        refusal: Coded<Refusal> => "";
        /// Lowest version of the protocol that the sender speaks.
        version_min: u8 => "" [1.0, 255.0];
        /// Highest version of the protocol that the sender speaks.
        version_current: u8 => "" [1.0, 255.0];
        /// The reason in words.
        detail: Text<96> => "";
    }
}

impl Refuse {
    /// A refusal with the versions that this program speaks.
    pub fn new(refusal: Refusal, detail: &str) -> Self {
        Self { refusal: refusal.into(), version_min: PROTOCOL_MIN, version_current: PROTOCOL_CURRENT, detail: Text::new(detail) }
    }
}
