//! A stream from a peer, in pieces as TCP gives it: no panic, and the same messages however it was cut.
use bytes::BytesMut;
use stars::wire::{Reader, decode_all};

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    // The first byte is the size of the pieces.
    let Some((size, stream)) = data.split_first() else { return };
    let (mut reader, mut buffer) = (Reader::default(), BytesMut::new());
    let mut in_pieces = Vec::new();
    for piece in stream.chunks(usize::from(*size).max(1)) {
        buffer.extend_from_slice(piece);
        while let Some(result) = reader.next(&mut buffer).transpose() {
            in_pieces.push(result.map_err(|error| error.label()));
        }
    }
    let at_once: Vec<_> = decode_all(stream).into_iter().map(|result| result.map_err(|error| error.label())).collect();
    assert_eq!(in_pieces, at_once);
}
