//! Tells which of several threads ends the process, by a signal or by `exit`: its word is copied to the one that another
//! process reads.

use std::cell::Cell;
use std::ffi::c_int;
use std::ptr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::SharedMemory;

/// Where the word of the thread that ends the process is copied to; never unmapped.
static LAST: OnceLock<SharedMemory> = OnceLock::new();

thread_local! {
    /// The first word of memory that is never unmapped, or NULL.
    static OWN: Cell<*const AtomicU64> = const { Cell::new(ptr::null()) };
}

/// From now on, if this thread ends the process, the first word of `own` is copied to the first word of `last`, which is
/// the same for all threads, unless the word is 0.
pub fn tell_crashes(own: &SharedMemory, last: &SharedMemory) {
    OWN.set(ptr::from_ref(&own.first()[0]));
    // The words must stay where they are.
    std::mem::forget(own.clone());
    if LAST.set(last.clone()).is_ok() {
        watch();
    }
}

/// Copies the word of this thread. Makes no calls that a signal handler must not make.
extern "C" fn tell() {
    let own = OWN.get();
    if let (Some(last), false) = (LAST.get(), own.is_null()) {
        // SAFETY: the memory of `own` is never unmapped.
        let word = unsafe { &*own }.load(Relaxed);
        if word != 0 {
            last.first()[0].store(word, Relaxed);
        }
    }
}

/// Has [`tell`] called when this process ends.
fn watch() {
    unsafe extern "C" {
        fn atexit(call: extern "C" fn()) -> c_int;
    }
    // SAFETY: the function has no arguments.
    unsafe { atexit(tell) };
    #[cfg(target_os = "linux")]
    signals::watch();
}

#[cfg(target_os = "linux")]
mod signals {
    use std::ffi::{c_int, c_void};
    use std::sync::OnceLock;

    /// `struct sigaction` of glibc and musl.
    #[repr(C)]
    struct Action {
        handler: usize,
        mask: [u64; 16],
        flags: c_int,
        restorer: usize,
    }

    /// The start of `siginfo_t`.
    #[repr(C)]
    struct Info {
        number: c_int,
        error: c_int,
        code: c_int,
    }

    unsafe extern "C" {
        fn sigaction(number: c_int, new: *const Action, old: *mut Action) -> c_int;
        safe fn raise(number: c_int) -> c_int;
    }

    const SA_SIGINFO: c_int = 4;
    const SA_ONSTACK: c_int = 0x0800_0000;
    /// Illegal instruction, abort, illegal memory access, arithmetic error, illegal memory access.
    const NUMBERS: [c_int; 5] = [4, 6, 7, 8, 11];

    /// What was done at each signal before.
    static BEFORE: OnceLock<[Action; NUMBERS.len()]> = OnceLock::new();

    pub(super) fn watch() {
        let handler = at_signal as extern "C" fn(c_int, *const Info, *mut c_void);
        let ours = Action {
            handler: handler as usize,
            mask: [0; 16],
            flags: SA_SIGINFO | SA_ONSTACK,
            restorer: 0,
        };
        let before = NUMBERS.map(|number| {
            let mut before = Action { handler: 0, mask: [0; 16], flags: 0, restorer: 0 };
            // SAFETY: the actions have the layout of the C library, which sets the restorer.
            unsafe { sigaction(number, std::ptr::null(), &raw mut before) };
            before
        });
        // Before a handler can need it.
        if BEFORE.set(before).is_ok() {
            for number in NUMBERS {
                // SAFETY: as above; the handler makes only calls that it may make.
                unsafe { sigaction(number, &raw const ours, std::ptr::null_mut()) };
            }
        }
    }

    extern "C" fn at_signal(number: c_int, info: *const Info, _: *mut c_void) {
        super::tell();
        let place = NUMBERS.iter().position(|known| *known == number);
        if let (Some(before), Some(place)) = (BEFORE.get(), place) {
            // SAFETY: the action is one that `sigaction` has returned.
            unsafe { sigaction(number, &raw const before[place], std::ptr::null_mut()) };
        }
        // An instruction that has failed fails again, and is handled as before; a signal that was sent is sent again.
        // SAFETY: with SA_SIGINFO, the information is there.
        if unsafe { (*info).code } <= 0 {
            raise(number);
        }
    }
}
