//! The service room: the actors and the channels between them.

mod codec;

pub use codec::{Codec, LinkError};
