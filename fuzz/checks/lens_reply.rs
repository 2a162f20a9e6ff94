//! What the lens controller says: any line is a reply or is refused with its text; and whatever it says, the machine that speaks
//! with it answers each request once, moves nothing after a stop, and knows nothing that was not read.
use stars::lens::{
    Action, AperturePosition, Control, Event, FocusCounts, Known, LensCommand, LensResult, RequestCounter, Rules, Word,
};
use stars::settings::Settings;
use std::collections::BTreeSet;
use std::sync::LazyLock;
use std::time::Duration;

static RULES: LazyLock<Rules> = LazyLock::new(|| Rules::of(&Settings::flight().expect("the flight's own settings").lens));

const COMMANDS: [LensCommand; 9] = [
    LensCommand::Flush,
    LensCommand::InitFocus,
    LensCommand::GetFocus,
    LensCommand::SetFocus(FocusCounts(7)),
    LensCommand::MoveFocus(-2),
    LensCommand::InitAperture,
    LensCommand::GetAperture,
    LensCommand::SetAperture(AperturePosition(3)),
    LensCommand::Stop,
];

fn read_by_every_word(line: &[u8]) {
    for word in [
        Word::Version,
        Word::LearnFocus,
        Word::ReadFocus,
        Word::SetFocus(FocusCounts(7)),
        Word::MoveFocus(-2),
        Word::InitAperture,
        Word::ReadAperture,
        Word::SetAperture(AperturePosition(3)),
    ] {
        let _ = word.read(line);
    }
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    read_by_every_word(data);
    let mut control = Control::new(RULES.clone());
    let (mut open, mut stopped, mut next, mut now) = (BTreeSet::new(), false, 0, Duration::ZERO);
    let mut line = Vec::new();
    let mut events = vec![Event::Time];
    for byte in data {
        match byte {
            // Small bytes ask and let time pass; the rest is what the controller says.
            0..9 => {
                let command = COMMANDS[usize::from(*byte)];
                next += 1;
                open.insert(next);
                stopped = command == LensCommand::Stop || stopped && !command.moves();
                events.push(Event::Requests(vec![(RequestCounter(next), command)]));
            }
            b'\r' => events.push(Event::Line(std::mem::take(&mut line))),
            14 => events.push(Event::Lost { why: "gone".to_owned() }),
            16..32 => {
                now += Duration::from_millis(1 << (byte - 16));
                events.push(Event::Time);
            }
            _ => line.push(*byte),
        }
        while let Some(event) = events.pop() {
            let read = matches!(event, Event::Line(_));
            let before = control.state();
            for action in control.on(now, event) {
                match action {
                    Action::Open { nth: 0 } => events.push(Event::Opened { port: "port".to_owned() }),
                    Action::Open { .. } => events.push(Event::NoMorePorts),
                    Action::Close => {}
                    Action::Send(bytes) => {
                        let moves = [b"la", b"fa", b"mf", b"in", b"ma"].iter().any(|verb| bytes.starts_with(*verb));
                        assert!(!(moves && stopped), "it moves after a stop");
                    }
                    Action::Answer { counter, result: LensResult::Started } => assert!(open.contains(&counter.0)),
                    Action::Answer { counter, .. } => assert!(open.remove(&counter.0), "answered twice"),
                }
            }
            let after = control.state();
            if let (Known::Known(at), false) = (after.focus, read) {
                let was_hidden = matches!(before.focus, Known::Unknown(stars::lens::Doubt::Requested));
                assert!(was_hidden || before.focus == Known::Known(at), "known without a reading");
            }
        }
    }
}
