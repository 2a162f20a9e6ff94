//! A page that is open all the time: it reads each state that comes, and fetches the pixels of each frame that it tells of.

use super::account::Account;
use crate::service::Page;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::time::sleep;

/// As a browser does after its connection broke.
const RETRY: Duration = Duration::from_secs(1);
/// Bytes that wait within the process in either direction.
const LINE_BYTES: usize = 64 * 1024;
/// No event is as long, bytes.
const LONGEST_EVENT: usize = 1 << 20;
/// Before the number of the frame in a state.
const FRAME: &[u8] = b"\"frame\":{\"image\":";

/// The page of the run that is under way, if one is.
pub type Door = Arc<Mutex<Option<Page>>>;

/// Looks, for as long as it is let.
pub async fn look(door: Door, account: Account) {
    loop {
        let page = door.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(page) = page {
            // It ends with the run, or when the display is started again.
            let _ = read(&page, &account).await;
        }
        sleep(RETRY).await;
    }
}

async fn ask(page: &Page, path: &str, close: &str) -> Option<DuplexStream> {
    let (mut near, far) = tokio::io::duplex(LINE_BYTES);
    page.open(far);
    near.write_all(format!("GET {path} HTTP/1.1\r\nhost: soak\r\n{close}\r\n").as_bytes()).await.ok()?;
    Some(near)
}

/// Reads events until they end.
async fn read(page: &Page, account: &Account) -> Option<()> {
    let mut events = ask(page, "/events", "").await?;
    let (mut bytes, mut last) = (Vec::new(), None);
    let mut piece = vec![0; LINE_BYTES];
    loop {
        let count = events.read(&mut piece).await.ok().filter(|count| *count > 0)?;
        bytes.extend(piece.get(..count)?);
        while let Some(end) = place(&bytes, b"\n\n") {
            let event: Vec<u8> = bytes.drain(..end + 2).collect();
            account.page_state();
            let image = number_after(&event, FRAME);
            if image.is_some() && image != last {
                last = image;
                fetch(page, image?, account).await;
            }
        }
        if bytes.len() > LONGEST_EVENT {
            account.page_wrong(format!("an event of over {LONGEST_EVENT} bytes"));
            return None;
        }
    }
}

/// Fetches a frame: all of it comes, or the reason why it does not.
async fn fetch(page: &Page, image: u32, account: &Account) {
    let Some(mut answer) = ask(page, &format!("/frame.raw?image={image}"), "connection: close\r\n").await else { return };
    let mut bytes = Vec::new();
    if answer.read_to_end(&mut bytes).await.is_err() {
        return;
    }
    let Some(head) = place(&bytes, b"\r\n\r\n") else { return };
    let of = |name: &[u8]| number_after(bytes.get(..head).unwrap_or_default(), name).map(|number| number as usize);
    match of(b"HTTP/1.1 ") {
        Some(200) => {
            let wanted = of(b"x-stars-width: ").zip(of(b"x-stars-height: ")).map(|(width, height)| 2 * width * height);
            let got = bytes.len() - head - 4;
            // A run that ends breaks its answers off.
            if wanted == Some(got) {
                account.page_frame();
            }
        }
        // Its pixels are gone, or there is no time for pictures.
        Some(404 | 503) => {}
        other => account.page_wrong(format!("image {image} was answered with {other:?}")),
    }
}

fn place(bytes: &[u8], of: &[u8]) -> Option<usize> {
    bytes.windows(of.len()).position(|window| window == of)
}

fn number_after(bytes: &[u8], name: &[u8]) -> Option<u32> {
    let rest = bytes.get(place(bytes, name)? + name.len()..)?;
    let digits: Vec<u8> = rest.iter().copied().take_while(u8::is_ascii_digit).collect();
    std::str::from_utf8(&digits).ok()?.parse().ok()
}
