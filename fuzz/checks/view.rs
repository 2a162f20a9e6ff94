//! The thin-link view: any packets are refused by name or make a picture of the size that its head says.

use stars::image::view::{Assembly, packets_in};

/// Pixels that are allowed: more than the flight camera has.
const MOST_PIXELS: usize = 1 << 21;
/// Ranges of missing packets that are asked for.
const MOST_GAPS: usize = 5;

/// A packet around a payload, its checksum right.
fn packet(stream: u32, number: u8, payload: &[u8]) -> Vec<u8> {
    let mut packet = b"sV\x01".to_vec();
    packet.extend([number, 0, 0]);
    packet.extend(stream.to_le_bytes());
    packet.extend((payload.len() as u16).to_le_bytes());
    packet.extend(payload);
    packet.extend(crc32fast::hash(&packet).to_le_bytes());
    packet
}

/// Feeds one input; panics where what must hold does not. Each piece has a byte that says whether it is a packet as it stands or a payload,
/// a number, and its length in two bytes. The stream is that of the first head.
pub fn check(data: &[u8]) {
    packets_in(data).for_each(|packet| assert!(packet.len() <= data.len()));
    let mut pieces = Vec::new();
    let mut rest = data;
    while let [kind, number, low, high, after @ ..] = rest {
        let length = usize::from(u16::from_le_bytes([*low, *high])).min(after.len());
        let (piece, after) = after.split_at(length);
        pieces.push((kind & 1 == 1, *number, piece));
        rest = after;
    }
    let head = pieces.iter().find(|(payload, number, _)| *payload && *number == 0);
    let stream = head.map_or(0, |(_, _, piece)| crc32fast::hash(piece));
    let mut assembly = Assembly::new(None, MOST_PIXELS);
    for (payload, number, piece) in pieces {
        let before = assembly.progress().0;
        let taken = if payload { assembly.take(&packet(stream, number, piece)) } else { assembly.take(piece) };
        match taken {
            Ok(_) => assert!(assembly.progress().0 <= before + 1),
            Err(refusal) => assert!(!refusal.to_string().is_empty() && assembly.progress().0 == before),
        }
    }
    let gaps = assembly.missing(MOST_GAPS);
    assert!(gaps.len() <= MOST_GAPS && gaps.iter().all(|gap| gap.start < gap.end));
    assert_eq!(assembly.picture().is_some(), assembly.head().is_some());
    if let (Some(head), Some(picture)) = (assembly.head(), assembly.picture()) {
        assert_eq!((picture.width, picture.height), (head.width, head.height));
        assert_eq!(picture.pixels.len(), head.width * head.height);
        assert!(head.sources.iter().all(|source| source.x.is_finite() && source.y.is_finite() && source.flux.is_finite()));
        assert!(!assembly.is_exact() || gaps.is_empty());
    }
    if let Some(thumbnail) = assembly.thumbnail() {
        assert_eq!(thumbnail.pixels.len(), thumbnail.width * thumbnail.height);
    }
}
