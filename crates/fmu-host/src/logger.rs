//! The logger that FMUs call, and who gets what they log.
//!
//! `fmi2CallbackLogger` has a variable number of arguments, which stable Rust cannot define:
//! [`trampoline`](crate::trampoline) turns them into a `va_list`, and `vsnprintf` of the C library
//! formats them.

use std::collections::BTreeMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fmu_types::fmi2::{fmi2ComponentEnvironment, fmi2String};

use crate::Status;

/// What an FMU logs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Logged {
    /// The status that the FMU gives it.
    pub status: Status,
    /// The log category.
    pub category: String,
    /// The message, formatted, and cut if it has more than 4095 bytes.
    pub text: String,
}

/// Gets what one instance logs, maybe from a thread that the FMU has started.
type Sink = dyn Fn(Logged) + Send + Sync;

/// The sinks of all instances. An FMU gets its key for a component environment, and no pointer: one
/// that hands on another, or logs after it was freed, does no harm.
static SINKS: Mutex<BTreeMap<usize, Arc<Sink>>> = Mutex::new(BTreeMap::new());

fn sinks() -> MutexGuard<'static, BTreeMap<usize, Arc<Sink>>> {
    SINKS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A sink that is known to the logger, until it is dropped.
pub(crate) struct Registered(usize);

impl Registered {
    pub(crate) fn new(sink: Arc<Sink>) -> Self {
        static NEXT: AtomicUsize = AtomicUsize::new(1);
        let key = NEXT.fetch_add(1, Ordering::Relaxed);
        sinks().insert(key, sink);
        Self(key)
    }

    /// What the FMU passes to the logger.
    pub(crate) fn environment(&self) -> fmi2ComponentEnvironment {
        ptr::without_provenance_mut(self.0)
    }
}

impl Drop for Registered {
    fn drop(&mut self) {
        let sink = sinks().remove(&self.0);
        // Without the lock: what the sink owns may be dropped with it, and that may be anything.
        drop(sink);
    }
}

/// Formats a message and hands it on; does not unwind. `arguments` is a `va_list` of the platform, or
/// NULL if they cannot be read.
///
/// # Safety
/// The strings are NULL or end in zero, and the arguments are those that the format asks for.
pub(crate) unsafe extern "C" fn log(
    environment: fmi2ComponentEnvironment,
    _instance: fmi2String,
    status: c_int,
    category: fmi2String,
    format: fmi2String,
    arguments: *mut c_void,
) {
    let Some(sink) = sinks().get(&environment.addr()).map(Arc::clone) else {
        return;
    };
    // SAFETY: the caller's promise.
    let (category, text) = unsafe { (text(category), formatted(format, arguments)) };
    let logged = Logged {
        status: status.into(),
        category: category.unwrap_or_default(),
        text,
    };
    // C cannot be unwound. The panic was reported by the program's hook.
    let _ = catch_unwind(AssertUnwindSafe(move || sink(logged)));
}

// Where the C library of Windows has its functions of `printf`'s kind inline in its headers.
#[cfg_attr(
    all(windows, target_env = "msvc"),
    link(name = "legacy_stdio_definitions")
)]
unsafe extern "C" {
    /// A `va_list` is passed as a pointer, to itself or to the arguments, by each ABI of
    /// [`trampoline`](crate::trampoline).
    fn vsnprintf(
        buffer: *mut c_char,
        size: usize,
        format: *const c_char,
        arguments: *mut c_void,
    ) -> c_int;
}

/// # Safety
/// As for [`log`].
unsafe fn formatted(format: *const c_char, arguments: *mut c_void) -> String {
    const MAX_BYTES: usize = 4096;
    if format.is_null() || arguments.is_null() {
        // SAFETY: the caller's promise.
        return unsafe { text(format) }.unwrap_or_default();
    }
    let mut buffer = [0_u8; MAX_BYTES];
    // The last byte stays zero, even where a C library leaves a text that it cuts without an end.
    // SAFETY: the buffer is larger than the size, and the rest is the caller's promise.
    let length = unsafe { vsnprintf(buffer.as_mut_ptr().cast(), MAX_BYTES - 1, format, arguments) };
    match CStr::from_bytes_until_nul(&buffer) {
        Ok(text) if length >= 0 || !text.is_empty() => text.to_string_lossy().into_owned(),
        // SAFETY: the caller's promise.
        _ => unsafe { text(format) }.unwrap_or_default(),
    }
}

/// The text behind a pointer; none for NULL.
///
/// # Safety
/// `pointer` is NULL or points to a text that ends in zero.
pub(crate) unsafe fn text(pointer: *const c_char) -> Option<String> {
    if pointer.is_null() {
        return None;
    }
    // SAFETY: not NULL by the check, and a C string by the caller's promise.
    let text = unsafe { CStr::from_ptr(pointer) };
    Some(text.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trampoline::logger;

    /// The logger's type, with a status that may be any integer.
    type Logger = unsafe extern "C" fn(
        fmi2ComponentEnvironment,
        fmi2String,
        c_int,
        fmi2String,
        fmi2String,
        ...
    );

    fn as_called() -> Logger {
        // SAFETY: a status is an integer of C.
        unsafe { std::mem::transmute(logger()) }
    }

    type Kept = Arc<Mutex<Vec<Logged>>>;

    fn kept() -> (Kept, Registered) {
        let kept = Kept::default();
        let sink = Arc::clone(&kept);
        let registered = Registered::new(Arc::new(move |logged| sink.lock().unwrap().push(logged)));
        (kept, registered)
    }

    /// What a format makes of arguments.
    macro_rules! logged {
        ($format:expr $(, $argument:expr)*) => {{
            let (kept, registered) = kept();
            let (log, format): (Logger, &CStr) = (as_called(), $format);
            // SAFETY: strings that end in zero, and arguments that the format asks for.
            unsafe {
                log(registered.environment(), c"a".as_ptr(), 1, c"c".as_ptr(), format.as_ptr()
                    $(, $argument)*);
            }
            let mut kept = kept.lock().unwrap();
            assert_eq!(kept.len(), 1);
            kept.remove(0)
        }};
    }

    #[test]
    fn arguments_of_every_kind_are_formatted_wherever_the_abi_passes_them() {
        let (a, b) = (c"text".as_ptr(), c"other".as_ptr());
        let none = logged!(c"100%% plain");
        assert_eq!(
            (none.status, none.category.as_str()),
            (Status::Warning, "c")
        );
        assert_eq!(none.text, "100% plain");
        assert_eq!(logged!(c"%s=%d", a, -7).text, "text=-7");
        let many = logged!(
            c"%d %s %g %d %s %g %lld %d %g %g %g %g %g %g %g %d %s %g",
            1,
            a,
            2.5,
            3,
            b,
            4.5,
            i64::MIN,
            5,
            0.25,
            6.0,
            7.0,
            8.0,
            9.0,
            10.0,
            11.0,
            12,
            a,
            13.0
        );
        assert_eq!(
            many.text,
            "1 text 2.5 3 other 4.5 -9223372036854775808 5 0.25 6 7 8 9 10 11 12 text 13"
        );
        assert_eq!(
            logged!(c"%*d|%.*f|%c", 5, 42, 2, 1.0 / 3.0, 65).text,
            "   42|0.33|A"
        );
    }

    #[test]
    fn a_long_message_is_cut_and_one_that_is_not_utf_8_is_readable() {
        let long = std::ffi::CString::new("x".repeat(100_000)).unwrap();
        assert_eq!(logged!(c"%s", long.as_ptr()).text, "x".repeat(4094));
        assert_eq!(logged!(c"%s", c"caf\xe9 1".as_ptr()).text, "caf\u{fffd} 1");
    }

    #[test]
    fn a_status_may_be_any_integer_and_strings_may_be_missing() {
        let (kept, registered) = kept();
        let log = as_called();
        // SAFETY: the format asks for no arguments; NULL is allowed.
        unsafe {
            log(
                registered.environment(),
                ptr::null(),
                42,
                ptr::null(),
                c"m".as_ptr(),
            );
            log(
                registered.environment(),
                ptr::null(),
                -1,
                ptr::null(),
                ptr::null(),
            );
        }
        let kept = kept.lock().unwrap();
        assert_eq!(
            (kept[0].status, kept[0].text.as_str()),
            (Status::Unknown(42), "m")
        );
        assert_eq!(
            (kept[1].status, kept[1].text.as_str()),
            (Status::Unknown(-1), "")
        );
    }

    #[test]
    fn a_message_from_another_thread_arrives_and_one_of_nobody_does_no_harm() {
        let (kept, registered) = kept();
        let (log, key) = (as_called(), registered.environment().addr());
        let say = move || {
            let environment = ptr::without_provenance_mut(key);
            // SAFETY: the format asks for one integer.
            unsafe { log(environment, ptr::null(), 0, ptr::null(), c"%d".as_ptr(), 1) }
        };
        std::thread::spawn(say).join().unwrap();
        drop(registered);
        say();
        assert_eq!(kept.lock().unwrap().len(), 1);
    }

    #[test]
    fn a_panic_of_the_sink_does_not_reach_the_fmu() {
        let registered = Registered::new(Arc::new(|_| panic!("in the sink")));
        // SAFETY: the format asks for no arguments.
        unsafe {
            as_called()(
                registered.environment(),
                ptr::null(),
                0,
                ptr::null(),
                c"m".as_ptr(),
            );
        }
    }
}
