//! Keeps time with the monotonic clock: sleeps until a time, and gives a thread the priority and the memory that it needs to
//! wake up on time, where the system allows it.

use std::io;
use std::num::NonZeroU64;
use std::time::Duration;

#[cfg(target_os = "linux")]
use linux as system;
#[cfg(not(target_os = "linux"))]
use other as system;

/// The time of the monotonic clock.
pub fn now() -> Duration {
    system::now()
}

/// Sleeps until a time of the monotonic clock; returns at once if it has passed.
pub fn sleep_until(time: Duration) {
    system::sleep_until(time);
}

/// The priority and the memory of a thread in real time; dropped, they are as before.
#[derive(Debug)]
pub struct RealTimeThread {
    slack: Option<NonZeroU64>,
    scheduling: Option<system::Scheduling>,
    is_locked: bool,
}

/// What the system did not allow, and why.
#[derive(Debug)]
pub struct Refused {
    /// The means, such as `SCHED_FIFO`.
    pub means: &'static str,
    /// The answer of the system.
    pub reason: io::Error,
}

impl RealTimeThread {
    /// Schedules this thread by `SCHED_FIFO`, so that it runs before all ordinary ones as soon as it wakes up, and locks
    /// the memory of the process, so that no page has to be read again. Returns also what is not allowed.
    pub fn enter() -> (Self, Vec<Refused>) {
        let mut refused = Vec::new();
        let mut refuse = |means, reason| refused.push(Refused { means, reason });
        // An ordinary thread, too, wakes up on time rather than together with others.
        let slack = system::set_timer_slack(NonZeroU64::new(1));
        let scheduling = system::Scheduling::enter();
        let scheduling = scheduling.map_err(|reason| refuse("SCHED_FIFO", reason)).ok();
        let locked = system::lock_memory().map_err(|reason| refuse("locked memory", reason));
        (Self { slack, scheduling, is_locked: locked.is_ok() }, refused)
    }
}

impl Drop for RealTimeThread {
    fn drop(&mut self) {
        system::set_timer_slack(self.slack);
        if let Some(scheduling) = &self.scheduling {
            scheduling.leave();
        }
        if self.is_locked {
            system::unlock_memory();
        }
    }
}

#[cfg(target_os = "linux")]
mod linux {
    use std::ffi::{c_int, c_ulong};
    use std::io;
    use std::num::NonZeroU64;
    use std::time::Duration;

    use rustix::mm::{MlockAllFlags, mlockall, munlockall};
    use rustix::thread::{clock_nanosleep_absolute, current_timer_slack, set_current_timer_slack};
    use rustix::time::{ClockId, Timespec, clock_gettime};

    pub fn now() -> Duration {
        let Timespec { tv_sec, tv_nsec } = clock_gettime(ClockId::Monotonic);
        Duration::new(tv_sec.unsigned_abs(), tv_nsec as u32)
    }

    pub fn sleep_until(time: Duration) {
        // A time that the system does not know is far away.
        let tv_sec = time.as_secs().min(i64::MAX as u64 / 2) as i64;
        let time = Timespec { tv_sec, tv_nsec: time.subsec_nanos().into() };
        // An absolute time needs no correction after a signal.
        while clock_nanosleep_absolute(ClockId::Monotonic, &time) == Err(rustix::io::Errno::INTR) {}
    }

    pub fn lock_memory() -> io::Result<()> {
        // Not what is mapped later: beyond the limit, it would fail.
        Ok(mlockall(MlockAllFlags::CURRENT)?)
    }

    pub fn unlock_memory() {
        let _ = munlockall();
    }

    /// Sets by how much the timers of this thread may be late (ns); returns the value before.
    pub fn set_timer_slack(slack: Option<NonZeroU64>) -> Option<NonZeroU64> {
        let before = current_timer_slack().ok().and_then(NonZeroU64::new);
        let _ = set_current_timer_slack(slack);
        before
    }

    /// How a thread was scheduled.
    #[derive(Debug)]
    pub struct Scheduling {
        policy: c_int,
        parameters: Parameters,
    }

    /// `struct sched_param`, with room for what a C library adds.
    #[repr(C)]
    #[derive(Debug, Default)]
    struct Parameters {
        priority: c_int,
        other: [c_int; 11],
    }

    unsafe extern "C" {
        safe fn pthread_self() -> c_ulong;
        fn pthread_setschedparam(
            thread: c_ulong,
            policy: c_int,
            parameters: *const Parameters,
        ) -> c_int;
        fn pthread_getschedparam(
            thread: c_ulong,
            policy: *mut c_int,
            parameters: *mut Parameters,
        ) -> c_int;
    }

    const SCHED_FIFO: c_int = 1;
    /// Before ordinary threads, after the threads of the kernel that handle interrupts, which have 50.
    const PRIORITY: c_int = 40;

    impl Scheduling {
        pub fn enter() -> io::Result<Self> {
            let mut before = Self { policy: 0, parameters: Parameters::default() };
            // SAFETY: the thread is this one, and the pointers are valid.
            let got = unsafe {
                let Self { policy, parameters } = &mut before;
                pthread_getschedparam(pthread_self(), policy, parameters)
            };
            let wanted = Parameters { priority: PRIORITY, ..Parameters::default() };
            // SAFETY: as above.
            let set =
                unsafe { pthread_setschedparam(pthread_self(), SCHED_FIFO, &raw const wanted) };
            match (got, set) {
                (0, 0) => Ok(before),
                (0, error) | (error, _) => Err(io::Error::from_raw_os_error(error)),
            }
        }

        pub fn leave(&self) {
            // SAFETY: as above.
            let _ = unsafe {
                pthread_setschedparam(pthread_self(), self.policy, &raw const self.parameters)
            };
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod other {
    use std::io;
    use std::num::NonZeroU64;
    use std::sync::LazyLock;
    use std::thread;
    use std::time::{Duration, Instant};

    pub fn now() -> Duration {
        static ORIGIN: LazyLock<Instant> = LazyLock::new(Instant::now);
        ORIGIN.elapsed()
    }

    pub fn sleep_until(time: Duration) {
        thread::sleep(time.saturating_sub(now()));
    }

    /// How a thread was scheduled.
    #[derive(Debug)]
    pub struct Scheduling;

    impl Scheduling {
        pub fn enter() -> io::Result<Self> {
            Err(io::ErrorKind::Unsupported.into())
        }

        pub fn leave(&self) {}
    }

    pub fn set_timer_slack(_: Option<NonZeroU64>) -> Option<NonZeroU64> {
        None
    }

    pub fn lock_memory() -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub fn unlock_memory() {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sleep_ends_at_its_time_or_later_and_at_once_if_that_has_passed() {
        let begin = now();
        let end = begin + Duration::from_millis(5);
        let (thread, refused) = RealTimeThread::enter();
        assert_eq!(refused.is_empty(), thread.scheduling.is_some() && thread.is_locked);
        sleep_until(end);
        drop(thread);
        assert!(now() >= end);
        sleep_until(begin);
        sleep_until(Duration::ZERO);
    }
}
