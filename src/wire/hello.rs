//! `Hello`: the first message either way.

use super::code::codes;
use super::element::body;
use super::{Coded, Maybe, PROTOCOL_CURRENT, PROTOCOL_MIN, Refusal, Refuse, Text, U32Le};

/// What a hello begins with, so that a stranger on the port is known for one.
pub const MAGIC: &str = "STARSCAM";

/// What stands at an end of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// A star camera.
    Camera,
    /// A flight computer.
    FlightComputer,
}

codes!(Role {
    1 Camera "camera",
    2 FlightComputer "flight_computer",
});

body! {
    /// First message either way: who is there, and which versions it speaks.
    pub struct Hello {
        /// Always `STARSCAM`.
        magic: Text<8> => "";
        /// Lowest version of the protocol that the sender speaks.
        version_min: u8 => "" [1.0, 255.0];
        /// Highest version of the protocol that the sender speaks.
        version_current: u8 => "" [1.0, 255.0];
        /// CRC-32 of the sender's layout tables; another number in the same version means that one end was built wrong.
        /// Unknown where the sender has no tables to compute it from.
        schema_hash: Maybe<U32Le> => "";
        /// What the sender is.
        role: Coded<Role> => "";
        /// Which of its kind it is: flight computers are told apart by this number.
        id: u8 => "" [1.0, 255.0];
        /// Its name, for logs.
        name: Text<16> => "";
        /// Number drawn at random at the sender's start: another one means that it started anew.
        boot_id: U32Le => "";
        /// Version of the sender's program.
        build: Text<32> => "";
        /// CRC-32 of the sender's settings.
        settings_hash: Maybe<U32Le> => "";
    }
}

impl Hello {
    /// A hello of this program.
    pub fn new(role: Role, id: u8, name: &str, boot_id: u32, settings_hash: Option<u32>) -> Self {
        Self {
            magic: Text::new(MAGIC),
            version_min: PROTOCOL_MIN,
            version_current: PROTOCOL_CURRENT,
            schema_hash: Some(super::schema_hash()).into(),
            role: role.into(),
            id,
            name: Text::new(name),
            boot_id: boot_id.into(),
            build: Text::new(env!("CARGO_PKG_VERSION")),
            settings_hash: settings_hash.into(),
        }
    }

    /// Highest version that both ends speak, or the refusal to answer with before closing.
    pub fn agree(&self, theirs: &Self) -> Result<u8, Refuse> {
        let version = self.version_current.min(theirs.version_current);
        if theirs.magic != self.magic {
            Err(Refuse::new(Refusal::NotAHello, "the first message must be a hello with the magic STARSCAM"))
        } else if theirs.role == self.role {
            Err(Refuse::new(Refusal::WrongRole, "a camera talks to flight computers alone"))
        } else if version < self.version_min.max(theirs.version_min) {
            let detail = format!("you speak {} to {}", theirs.version_min, theirs.version_current);
            Err(Refuse::new(Refusal::NoCommonVersion, &detail))
        } else {
            Ok(version)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hello(role: Role, version_min: u8, version_current: u8) -> Hello {
        Hello { version_min, version_current, ..Hello::new(role, 1, "test", 7, None) }
    }

    #[test]
    fn the_highest_common_version_is_spoken() {
        let ours = hello(Role::Camera, 2, 4);
        assert_eq!(ours.agree(&hello(Role::FlightComputer, 1, 3)), Ok(3));
        assert_eq!(ours.agree(&hello(Role::FlightComputer, 4, 9)), Ok(4));
    }

    #[test]
    fn no_common_version_is_refused_and_says_what_is_spoken() {
        for (low, high) in [(1, 1), (5, 6)] {
            let refuse = hello(Role::Camera, 2, 4).agree(&hello(Role::FlightComputer, low, high)).unwrap_err();
            assert_eq!(refuse.refusal.get(), Some(Refusal::NoCommonVersion));
            assert_eq!((refuse.version_min, refuse.version_current), (PROTOCOL_MIN, PROTOCOL_CURRENT));
            assert_eq!(refuse.detail.to_string(), format!("you speak {low} to {high}"));
        }
    }

    #[test]
    fn strangers_and_other_cameras_are_refused() {
        let ours = hello(Role::Camera, 1, 1);
        assert_eq!(ours.agree(&ours).unwrap_err().refusal.get(), Some(Refusal::WrongRole));
        let stranger = Hello { magic: Text::new("GET / HT"), ..hello(Role::FlightComputer, 1, 1) };
        assert_eq!(ours.agree(&stranger).unwrap_err().refusal.get(), Some(Refusal::NotAHello));
    }
}
