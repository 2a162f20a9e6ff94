//! Inboxes: bounded channels whose receiving end outlives the actor that reads it.

use std::sync::Arc;
use tokio::sync::{Mutex, OwnedMutexGuard, mpsc};

/// The receiving end of an actor's channel. When the actor is started again it goes on with what waits here.
#[derive(Debug)]
pub struct Inbox<T>(Arc<Mutex<mpsc::Receiver<T>>>);

/// A channel for at most `capacity` messages.
pub fn channel<T>(capacity: usize) -> (mpsc::Sender<T>, Inbox<T>) {
    let (sender, receiver) = mpsc::channel(capacity);
    (sender, Inbox(Arc::new(Mutex::new(receiver))))
}

impl<T> Inbox<T> {
    /// The receiver, for as long as the actor lives; given back even when the actor panics.
    pub async fn open(&self) -> OwnedMutexGuard<mpsc::Receiver<T>> {
        Arc::clone(&self.0).lock_owned().await
    }
}

impl<T> Clone for Inbox<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn what_waits_survives_the_actor_that_should_have_read_it() {
        let (sender, inbox) = channel(4);
        sender.send(1).await.unwrap();
        sender.send(2).await.unwrap();
        let first = inbox.clone();
        let actor = tokio::spawn(async move {
            assert_eq!(first.open().await.recv().await, Some(1));
            panic!("the actor breaks");
        });
        assert!(actor.await.unwrap_err().is_panic());
        assert_eq!(inbox.open().await.recv().await, Some(2));
    }
}
