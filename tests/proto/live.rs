//! The Python client against a camera made of the wire room and a plain socket.

use crate::{frame, proto, samples};
use serde_json::Value;
use stars::wire::{Hello, Message, Reader, Refusal, Refuse, Role};
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

/// Starts the client against a listener, lets `camera` serve its first connection, and gives what the client printed.
fn client(arguments: &[&str], camera: impl FnOnce(TcpStream)) -> Output {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let child = Command::new("python3")
        .arg(proto("stars_client.py"))
        .args(["--connect", &address])
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap_or_else(|error| panic!("python3 is needed to check proto/ and does not start: {error}"));
    let (stream, _) = listener.accept().unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    camera(stream);
    child.wait_with_output().unwrap()
}

/// The next message of the client.
fn receive(stream: &mut TcpStream, reader: &mut Reader, buffer: &mut bytes::BytesMut) -> Message {
    loop {
        if let Some(message) = reader.next(buffer).unwrap() {
            return message;
        }
        let mut bytes = [0; 4096];
        let count = stream.read(&mut bytes).unwrap();
        assert!(count > 0, "the client closed the connection");
        buffer.extend_from_slice(&bytes[..count]);
    }
}

fn sample(name: &str) -> Message {
    samples::all().into_iter().find(|(other, _)| *other == name).unwrap().1
}

#[test]
fn the_python_client_shakes_hands_sends_its_status_and_prints_updates() {
    let output = client(&["--id", "2", "--in-charge", "--updates", "2", "--json"], |mut stream| {
        let (mut reader, mut buffer) = (Reader::default(), bytes::BytesMut::new());
        let Message::Hello(theirs) = receive(&mut stream, &mut reader, &mut buffer) else { panic!("no hello") };
        let ours = Hello::new(Role::Camera, 1, "xsc0", 77, None);
        assert_eq!(ours.agree(&theirs), Ok(1));
        assert_eq!(theirs.id, 2);
        stream.write_all(&frame(&Message::Hello(Box::new(ours)))).unwrap();
        let Message::Status(status) = receive(&mut stream, &mut reader, &mut buffer) else { panic!("no status") };
        assert!(status.claims_charge && status.uptime_s >= 0.0);
        // In pieces, as a network would.
        let bytes = [frame(&sample("update_solved")), frame(&sample("update_unsolved"))].concat();
        bytes.chunks(100).for_each(|piece| stream.write_all(piece).unwrap());
    });
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines: Vec<Value> =
        output.stdout.split(|byte| *byte == b'\n').filter_map(|line| serde_json::from_slice(line).ok()).collect();
    let kinds: Vec<_> = lines.iter().map(|line| line["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["connected", "update", "update"]);
    assert_eq!(lines[1]["ra_deg"], 136.564_602);
    assert_eq!(lines[2]["reason"], "undecided");
}

#[test]
fn the_python_client_says_why_it_was_refused() {
    let output = client(&["--id", "1", "--updates", "1", "--json", "--once"], |mut stream| {
        let refuse = Refuse::new(Refusal::NoCommonVersion, "you speak 1 to 1");
        stream.write_all(&frame(&Message::Refuse(Box::new(refuse)))).unwrap();
        // Read what it still sends, so that closing does not reset the connection under the refusal.
        let _ = stream.shutdown(std::net::Shutdown::Write);
        let _ = stream.read_to_end(&mut Vec::new());
    });
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("\"closed\"") && text.contains("no_common_version"), "{text}");
}
