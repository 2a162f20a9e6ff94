//! A thin link that loses packets, and asks for them again.

use crate::image::view::{Assembly, View};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Packets between two requests of the receiver: two seconds at 9600 baud.
const ROUND: usize = 8;
/// Ranges of missing packets that a request has room for, as a short command would.
const MOST_GAPS: usize = 8;

/// Sends a view to a receiver. Packets and requests are lost by chance; what is asked for goes before what is new.
#[derive(Debug)]
pub struct ThinLink<'a> {
    view: &'a View,
    loss: f64,
    random: ChaCha8Rng,
    /// The first packet that was not sent yet.
    next: usize,
    /// Packets sent, those that were lost too.
    pub packets: usize,
    /// Their bytes.
    pub bytes: usize,
}

impl<'a> ThinLink<'a> {
    /// A link that loses this part of all that goes over it.
    pub fn new(view: &'a View, loss: f64, seed: u64) -> Self {
        Self { view, loss, random: ChaCha8Rng::seed_from_u64(seed), next: 0, packets: 0, bytes: 0 }
    }

    fn arrives(&mut self) -> bool {
        self.random.random::<f64>() >= self.loss
    }

    /// One request of the receiver, and the packets that follow.
    pub fn round(&mut self, assembly: &mut Assembly) {
        let gaps = if self.arrives() { assembly.missing(MOST_GAPS) } else { Vec::new() };
        let again = gaps.into_iter().flatten().map(|number| number as usize).take_while(|&number| number < self.next);
        let sent: Vec<usize> = again.chain(self.next..self.view.len()).take(ROUND).collect();
        for number in sent {
            self.next = self.next.max(number + 1);
            let Some(packet) = self.view.packet(number) else { continue };
            self.packets += 1;
            self.bytes += packet.len();
            if self.arrives() {
                // One that is refused is missing still, and asked for again.
                let _ = assembly.take(packet);
            }
        }
    }
}
