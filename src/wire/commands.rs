//! `Commands`: the block of commands that a flight computer relays, and what an update says of them.

use super::code::codes;
use super::element::body;
use super::{Coded, List, Maybe, Text, U16Le, U32Le};
use crate::command::{self, Act, BootId, Epoch, MAX_VALUES, Refusal, Stage};

/// Commands that a block has room for.
pub const SLOTS: usize = 8;
/// Replies that an update has room for.
const REPLIES: usize = command::REPLIES;

codes!(Refusal {
    1 NotInCharge "not_in_charge",
    2 Stale "stale",
    3 Replayed "replayed",
    4 OutOfRange "out_of_range",
    5 Busy "busy",
    6 NotArmed "not_armed",
    7 UnknownCommand "unknown_command",
    8 UnsafeState "unsafe_state",
    9 NotAuthentic "not_authentic",
    10 HalfChanged "half_changed",
    11 Early "early",
    12 WrongBoot "wrong_boot",
    13 NotAvailable "not_available",
    14 NotKept "not_kept",
    15 Stopped "stopped",
    16 Device "device",
    17 Program "program",
    18 Dialect "dialect",
    19 NoResult "no_result",
    20 Restarted "restarted",
});

codes!(Stage {
    1 Accepted "accepted",
    2 Started "started",
    3 Completed "completed",
    4 Rejected "rejected",
    5 Failed "failed",
});

codes!(Act {
    1 Run "run",
    2 Arm "arm",
    3 Fire "fire",
});

body! {
    /// The commands that the sender was given of late, to the camera after each status for as long as one of them matters: a
    /// command stands in a block until its last reply has come, 15 s at most.
    pub struct Commands {
        /// Counts the sender's blocks of this connection, from 0.
        sequence: U32Le => "";
        /// The sender's boot, as in its hello.
        boot_id: U32Le => "";
        /// The camera's boot, as in its hello.
        camera_boot_id: U32Le => "";
        /// The lease that the sender holds, as the last update says.
        lease_epoch: U32Le => "";
        /// Sequence number of the last update received: it shows how long this block can have been on its way.
        last_update_sequence: Maybe<U32Le> => "";
        /// Replies up to this serial number have been received, and need not be repeated; 0: none.
        acknowledged: U32Le => "";
        /// How many of the commands below there are, at most 8.
        slots_count: u8 => "";
        /// The commands.
        slots: List<CommandSlot, 8> => "";
        /// HMAC-SHA-256 (RFC 2104) over all bytes of the body before this field's flag, with the sender's key.
        tag: Maybe<List<u8, 32>> => "";
    }
}

body! {
    /// A command.
    pub struct CommandSlot {
        /// Its number in the table of commands.
        command: u8 => "";
        /// 1 run, 2 arm, 3 fire.
        act: u8 => "";
        /// Counts the sender's commands of this number since its boot, from 1.
        counter: U32Le => "";
        /// Time since the ground gave it, from a clock that never jumps.
        age_s: f64 => "s";
        /// Its values in the order of the table, zeros after them.
        values: List<f64, 8> => "";
        /// CRC-32 (IEEE) over command, act, counter and values as they stand here, made when the ground gave the command and kept
        /// beside it: it shows that none of them changed alone.
        seal: U32Le => "";
    }
}

body! {
    /// What became of commands.
    pub struct Control {
        /// The lease of the flight computer in charge; it ends 3 s after the last status that renewed it.
        lease_epoch: Maybe<U32Le> => "";
        /// The command that may be fired now.
        armed_command: Maybe<u8> => "";
        /// Time that is left for it.
        armed_for_s: f64 => "s" [0.0, 3600.0];
        /// Commands under way.
        commands_under_way: u8 => "";
        /// Nothing runs whose sender does not show its key.
        authentication_required: bool => "";
        /// There is a key for the receiver of this update.
        authentication_key: bool => "";
        /// Counters of commands are kept on disk, so that none runs again after a restart.
        counters_kept: bool => "";
        /// Commands refused since the camera's start, by the codes of `last_refusal`.
        refused: List<U32Le, 20> => "";
        /// Settings that commands have changed from the values of the start.
        settings_commanded: U16Le => "";
        /// How many of the replies below there are.
        replies_count: u8 => "" [0.0, 32.0];
        /// Replies that the receiver has not acknowledged, oldest first; of more than 32 the last.
        replies: List<CommandReply, 32> => "";
    }
}

body! {
    /// A stage that a command reached.
    pub struct CommandReply {
        /// Counts all replies since the camera's start, from 1.
        serial: U32Le => "";
        /// The flight computer that gave the command.
        flight_computer: u8 => "";
        /// The command's number; 0 where a whole block was refused.
        command: u8 => "";
        /// Its counter.
        counter: U32Le => "";
        /// How far it has come.
        stage: Coded<Stage> => "";
        /// Why it was rejected or failed.
        why: Maybe<Coded<Refusal>> => "";
        /// Time since then.
        reply_age_s: f64 => "s" [0.0, 1e10];
        /// The reason or what came of it in words, cut where it is longer.
        words: Text<64> => "";
    }
}

impl CommandSlot {
    /// From the core's slot.
    pub fn new(slot: &command::Slot) -> Self {
        Self {
            command: slot.code,
            act: super::Code::code(slot.act),
            counter: slot.counter.into(),
            age_s: slot.age_s,
            values: slot.values.into(),
            seal: slot.seal.into(),
        }
    }

    /// As the core has it; an act that is none reads as `run`, and the seal then shows that it is wrong.
    fn slot(&self) -> command::Slot {
        let mut values = [0.0; MAX_VALUES];
        values.iter_mut().zip(self.values.as_slice()).for_each(|(to, from)| *to = *from);
        let act = match self.act {
            2 => Act::Arm,
            3 => Act::Fire,
            _ => Act::Run,
        };
        // A wrong act must not pass as `run`: its seal was made over another byte.
        let seal = if (1..=3).contains(&self.act) {
            self.seal.get()
        } else {
            !command::Slot::seal_of(self.command, act, self.counter.get(), &values)
        };
        command::Slot { code: self.command, act, counter: self.counter.get(), age_s: self.age_s, values, seal }
    }
}

impl Commands {
    /// The commands that it has.
    pub fn slots(&self) -> Vec<command::Slot> {
        self.slots.as_slice().iter().take(usize::from(self.slots_count)).map(CommandSlot::slot).collect()
    }

    /// The lease and the camera's boot that it was made under.
    pub fn under(&self) -> (BootId, Epoch) {
        (BootId(self.camera_boot_id.get()), Epoch(self.lease_epoch.get()))
    }

    /// The bytes that [`Self::tag`] is the code of.
    pub fn tagged_bytes(&self) -> Vec<u8> {
        const TAG: usize = 1 + command::TAG_BYTES;
        // A body of plain numbers always encodes.
        let mut bytes = postcard::to_stdvec(self).unwrap_or_default();
        bytes.truncate(bytes.len().saturating_sub(TAG));
        bytes
    }

    /// Its code, where it has one.
    pub fn tag(&self) -> Option<[u8; command::TAG_BYTES]> {
        self.tag.get().and_then(|tag| tag.as_slice().try_into().ok())
    }

    /// With the code of a key.
    #[must_use]
    pub fn signed(self, key: &command::Key) -> Self {
        let tag = key.tag(&self.tagged_bytes());
        Self { tag: Some(tag).into(), ..self }
    }
}

impl CommandReply {
    /// From the core's reply, `now` being the moment of the update.
    pub fn new(reply: &command::Reply, now: command::Tick) -> Self {
        Self {
            serial: reply.serial.into(),
            flight_computer: reply.to.0,
            command: reply.code,
            counter: reply.counter.into(),
            stage: reply.stage.into(),
            why: reply.why.into(),
            reply_age_s: now.saturating_sub(reply.at).as_secs_f64(),
            words: Text::new(&reply.detail),
        }
    }
}

impl Control {
    /// The replies that it has.
    pub fn replies(&self) -> impl Iterator<Item = &CommandReply> {
        self.replies.as_slice().iter().take(usize::from(self.replies_count).min(REPLIES))
    }

    /// With replies, the last where there are too many.
    #[must_use]
    pub fn with_replies(self, replies: &[CommandReply]) -> Self {
        let last = replies.get(replies.len().saturating_sub(REPLIES)..).unwrap_or_default();
        Self { replies_count: last.len() as u8, replies: List::from_slice(last), ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{Command, Slot};

    #[test]
    fn a_block_gives_back_its_commands_and_a_wrong_act_breaks_the_seal() {
        let slot = Slot::new(&Command::parse("lens.set_focus 3030").unwrap(), Act::Arm, 7, 1.5);
        let mut block = Commands { slots_count: 1, slots: List::from_slice(&[CommandSlot::new(&slot)]), ..Commands::default() };
        assert_eq!(block.slots(), [slot]);
        for act in [0, 4, 255] {
            block.slots = List::from_slice(&[CommandSlot { act, ..CommandSlot::new(&slot) }]);
            let read = block.slots()[0];
            assert_ne!(read.seal, Slot::seal_of(read.code, read.act, read.counter, &read.values));
        }
        block.slots_count = 255;
        assert_eq!(block.slots().len(), SLOTS);
    }

    #[test]
    fn the_code_covers_every_byte_before_it() {
        let key = command::Key::parse(&"5a".repeat(32)).unwrap();
        let block = Commands { sequence: 9.into(), ..Commands::default() }.signed(&key);
        assert!(key.verifies(&block.tagged_bytes(), &block.tag().unwrap()));
        assert_eq!(block.tagged_bytes().len() + 33, postcard::to_stdvec(&block).unwrap().len());
        let other = Commands { sequence: 10.into(), ..block };
        assert!(!key.verifies(&other.tagged_bytes(), &other.tag().unwrap()));
    }
}
