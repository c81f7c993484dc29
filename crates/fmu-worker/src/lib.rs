//! Waits for a process that runs foreign binaries, which may crash, exit, hang or fill the memory.
//!
//! ```no_run
//! use std::process::Command;
//! use std::time::Duration;
//!
//! let mut child = Command::new("worker").spawn()?;
//! let limits = fmu_worker::Limits { time: Some(Duration::from_secs(20)), ..Default::default() };
//! println!("the process {}", fmu_worker::wait(&mut child, &limits)?);
//! # std::io::Result::Ok(())
//! ```
#![forbid(unsafe_code)]

mod ended;
pub mod memory;

use std::io;
use std::process::Child;
use std::time::{Duration, Instant};

pub use ended::Ended;

/// What a process may use before it is killed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Limits {
    /// Time until it ends.
    pub time: Option<Duration>,
    /// Resident memory in bytes; only Linux tells how much a process uses.
    pub memory: Option<u64>,
}

/// Interval between checks of a process that runs for long.
const PERIOD: Duration = Duration::from_millis(20);

/// Waits until a process ends, and kills it when it exceeds a limit. If it leads a group of processes,
/// what it has started and left behind is killed, too.
///
/// # Errors
/// The system does not tell the state of the process.
pub fn wait(child: &mut Child, limits: &Limits) -> io::Result<Ended> {
    let ended = wait_for(child, limits);
    kill_group(child.id());
    ended
}

/// Kills what is left of the group of processes that a process with this number has led.
#[cfg(unix)]
pub fn kill_group(leader: u32) {
    use rustix::process::{Pid, Signal, kill_process_group};
    let group = i32::try_from(leader).ok().and_then(Pid::from_raw);
    // Usually, there is nothing left to kill.
    let _ = group.map(|group| kill_process_group(group, Signal::KILL));
}

/// Kills what is left of the group of processes that a process with this number has led.
#[cfg(not(unix))]
pub fn kill_group(_leader: u32) {}

fn wait_for(child: &mut Child, limits: &Limits) -> io::Result<Ended> {
    let start = Instant::now();
    let mut pause = Duration::from_millis(1);
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Ended::Exited(status));
        }
        if let Some(limit) = limits.time.filter(|limit| start.elapsed() >= *limit) {
            return kill(child, Ended::TimedOut(limit));
        }
        if let Some(used) = excess(child, limits) {
            return kill(child, Ended::OutOfMemory(used));
        }
        std::thread::sleep(pause);
        pause = (pause * 2).min(PERIOD);
    }
}

/// The memory of a process in bytes if it is more than its limit.
pub fn excess(child: &Child, limits: &Limits) -> Option<u64> {
    let limit = limits.memory?;
    memory::used(child.id()).filter(|used| *used > limit)
}

/// Kills a process for a reason, unless it has ended by itself.
///
/// # Errors
/// The system does not tell the state of the process.
pub fn kill(child: &mut Child, reason: Ended) -> io::Result<Ended> {
    if let Some(status) = child.try_wait()? {
        return Ok(Ended::Exited(status));
    }
    child.kill()?;
    child.wait()?;
    Ok(reason)
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::process::Command;

    fn ended(script: &str, limits: &Limits) -> String {
        let mut child = Command::new("sh").args(["-c", script]).spawn().unwrap();
        wait(&mut child, limits).unwrap().to_string()
    }

    #[test]
    fn every_end_is_described_in_plain_words() {
        let unlimited = Limits::default();
        for (script, text) in [
            ("exit 0", "exited with code 0 before it had finished"),
            ("exit 3", "exited with code 3 before it had finished"),
            (
                "kill -SEGV $$",
                "was ended by signal 11, illegal memory access",
            ),
            ("kill -ABRT $$", "was ended by signal 6, abort"),
        ] {
            assert_eq!(ended(script, &unlimited), text);
        }
    }

    #[test]
    fn a_process_is_killed_after_its_time() {
        let limits = Limits {
            time: Some(Duration::from_millis(50)),
            ..Limits::default()
        };
        let text = "did not return within 0.05 s and was killed";
        assert_eq!(ended("exec sleep 60", &limits), text);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_process_is_killed_when_it_uses_too_much_memory() {
        let limits = Limits {
            time: Some(Duration::from_secs(60)),
            memory: Some(40_000_000),
        };
        let text = ended("x=aaaaaaaa; while :; do x=$x$x; done", &limits);
        assert!(text.ends_with("GB of memory and was killed"), "{text}");
    }
}
