//! Work that can wait, so that frames do not.

use std::panic::resume_unwind;
use std::thread::{Builder, scope};

/// How far what is done aside gives way to the rest of the program (`setpriority(2)`): beside a busy thread it has a tenth of a core.
const NICE: i32 = 10;

/// Does a job on a thread of its own that gives way to the others, and waits for it. Where no such thread is to be had the job is done here.
pub fn aside<T: Send>(mut job: impl FnMut() -> T + Send) -> T {
    let done = scope(|scope| {
        let thread = Builder::new().name("aside".to_owned()).spawn_scoped(scope, || {
            // Of this thread alone, as Linux has it; where it is refused the thread is as quick as the others.
            let _ = rustix::process::setpriority_process(None, NICE);
            job()
        });
        Some(thread.ok()?.join().unwrap_or_else(|panic| resume_unwind(panic)))
    });
    done.unwrap_or_else(job)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_done_aside_gives_way_and_nothing_else_does() {
        let nice = || rustix::process::getpriority_process(None).unwrap();
        let here = nice();
        assert_eq!(aside(nice), NICE.max(here));
        assert_eq!(nice(), here);
    }
}
