//! The wire room's frames as a `tokio_util` codec.
//!
//! `FramedRead` gives the buffer 8 KiB at a time and hands it over after each read, so that it never holds more than one frame
//! of 64 KiB and one read. After an error the stream ends, which is what a session wants: it is closed and the peer comes back.

use crate::wire::{Message, PROTOCOL_CURRENT, Reader, WireError};
use bytes::BytesMut;
use tokio_util::codec::{Decoder, Encoder};

/// What can go wrong on a connection.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// What came is no message.
    #[error(transparent)]
    Wire(#[from] WireError),
    /// The connection broke.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}

/// Messages over a byte stream.
#[derive(Debug, Clone)]
pub struct Codec {
    reader: Reader,
    version: u8,
}

impl Default for Codec {
    fn default() -> Self {
        Self { reader: Reader::default(), version: PROTOCOL_CURRENT }
    }
}

impl Codec {
    /// Sends in this version from now on: the one that the hellos agreed upon.
    pub fn speak(&mut self, version: u8) {
        self.version = version;
    }

    /// Values received that were out of range and are not known therefore.
    pub fn values_withheld(&self) -> u32 {
        self.reader.values_withheld
    }
}

impl Decoder for Codec {
    type Item = Message;
    type Error = LinkError;

    fn decode(&mut self, buffer: &mut BytesMut) -> Result<Option<Message>, LinkError> {
        Ok(self.reader.next(buffer)?)
    }

    /// Half a frame at the end is no error: a peer may vanish at any byte.
    fn decode_eof(&mut self, buffer: &mut BytesMut) -> Result<Option<Message>, LinkError> {
        let message = self.decode(buffer)?;
        if message.is_none() {
            buffer.clear();
        }
        Ok(message)
    }
}

impl Encoder<&Message> for Codec {
    type Error = LinkError;

    fn encode(&mut self, message: &Message, out: &mut BytesMut) -> Result<(), LinkError> {
        Ok(message.encode_in(self.version, out)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::{SinkExt, StreamExt};
    use tokio::io::AsyncWriteExt;
    use tokio_util::codec::{FramedRead, FramedWrite};

    #[tokio::test]
    async fn messages_pass_through_a_stream_and_half_a_frame_ends_it_quietly() {
        let (near, far) = tokio::io::duplex(64);
        let message = Message::Status(Box::default());
        let sent = message.clone();
        tokio::spawn(async move {
            let mut out = FramedWrite::new(near, Codec::default());
            out.send(&sent).await.unwrap();
            let mut half = BytesMut::new();
            sent.encode(&mut half).unwrap();
            out.get_mut().write_all(&half[..40]).await.unwrap();
        });
        let mut frames = FramedRead::new(far, Codec::default());
        assert_eq!(frames.next().await.unwrap().unwrap(), message);
        assert!(frames.next().await.is_none());
    }

    #[tokio::test]
    async fn a_hostile_length_ends_the_stream_before_it_grows_the_buffer() {
        let (mut near, far) = tokio::io::duplex(1 << 16);
        near.write_all(&[0x1A, 0xCF, 0xFC, 0x1D, 0xFF, 0xFF, 0xFF, 0x7F]).await.unwrap();
        let mut frames = FramedRead::new(far, Codec::default());
        assert!(matches!(frames.next().await, Some(Err(LinkError::Wire(WireError::TooLong { .. })))));
        assert!(frames.next().await.is_none());
        assert!(frames.read_buffer().capacity() <= 16 * 1024);
    }
}
