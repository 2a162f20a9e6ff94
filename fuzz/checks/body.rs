//! A body whose checksum is right: what is read can be written, and reads the same again.
use stars::wire::{Message, PROTOCOL_CURRENT};

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let [kind, version, body @ ..] = data else { return };
    let Ok((message, _)) = Message::decode(*kind, *version, body) else { return };
    let written = message.body().expect("what was read can be written");
    let (again, withheld) = Message::decode(*kind, PROTOCOL_CURRENT, &written).expect("what was written can be read");
    assert_eq!((again, withheld), (message.clone(), 0));
    message.json().expect("what was read has a JSON form");
}
