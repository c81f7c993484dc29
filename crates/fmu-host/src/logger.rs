//! The logger that FMUs call, and the callbacks that receive log messages.
//!
//! `fmi2CallbackLogger` is variadic, and stable Rust can call variadic functions but not define them: for each
//! ABI, a few instructions build a `va_list` from the arguments and pass it to [`log`] as the sixth argument.
//! `vsnprintf` of the C library formats it.

use std::collections::BTreeMap;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use fmi_abi::FmiVersion;
use fmi_abi::fmi2::{fmi2CallbackLogger, fmi2ComponentEnvironment, fmi2String};
use fmi_abi::fmi3::{fmi3Boolean, fmi3False, fmi3Float64, fmi3InstanceEnvironment, fmi3String};

use crate::outcome::Status;

/// A log message of an FMU.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LogMessage {
    /// The name of the instance, as the FMU passes it.
    pub instance: Option<String>,
    /// The status of the message.
    pub status: Status,
    /// The log category; `None` if it was NULL, which the standard does not allow.
    pub category: Option<String>,
    /// The formatted message, truncated to 4094 bytes.
    pub text: String,
}

/// Receives the log messages of an instance, possibly on a thread that the FMU has started.
type Sink = dyn Fn(LogMessage) + Send + Sync;

/// Is called for each intermediate update, or each update of clocks.
pub type OnIntermediate = Arc<dyn Fn() + Send + Sync>;

/// The callbacks of an instance.
#[derive(Clone)]
struct Callbacks {
    sink: Arc<Sink>,
    intermediate: Option<OnIntermediate>,
    clock_update: Option<OnIntermediate>,
}

/// The callbacks of all instances. The component environment of an FMU is a key, not a pointer, so that an
/// FMU that passes another value, or logs after it was freed, does no harm.
static CALLBACKS: Mutex<BTreeMap<usize, Callbacks>> = Mutex::new(BTreeMap::new());

/// Number of messages without a sink.
static STRAY: AtomicUsize = AtomicUsize::new(0);

/// How many messages were logged with a wrong component environment, or after the instance was freed.
pub fn stray_messages() -> usize {
    STRAY.load(Ordering::Relaxed)
}

fn callbacks() -> MutexGuard<'static, BTreeMap<usize, Callbacks>> {
    CALLBACKS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Callbacks that are registered until this value is dropped.
pub(crate) struct Registered(usize);

impl Registered {
    pub(crate) fn new(sink: Arc<Sink>, intermediate: Option<OnIntermediate>) -> Self {
        static NEXT: AtomicUsize = AtomicUsize::new(1);
        let key = NEXT.fetch_add(1, Ordering::Relaxed);
        callbacks().insert(key, Callbacks { sink, intermediate, clock_update: None });
        Self(key)
    }

    /// Registers the receiver of updates of clocks.
    pub(crate) fn on_clock_update(&self, receive: OnIntermediate) {
        if let Some(callbacks) = callbacks().get_mut(&self.0) {
            callbacks.clock_update = Some(receive);
        }
    }

    /// The component environment that the FMU passes to the logger.
    pub(crate) fn environment(&self) -> fmi2ComponentEnvironment {
        ptr::without_provenance_mut(self.0)
    }
}

impl Drop for Registered {
    fn drop(&mut self) {
        let removed = callbacks().remove(&self.0);
        // Dropped without holding the lock, as dropping a callback may run any code.
        drop(removed);
    }
}

/// Formats a message and passes it to its sink; does not unwind. `arguments` is a `va_list` of the
/// platform, or NULL if the arguments cannot be read.
///
/// # Safety
/// The strings are NULL or zero-terminated, and the arguments match the format.
unsafe extern "C" fn log(
    environment: fmi2ComponentEnvironment,
    instance: fmi2String,
    status: c_int,
    category: fmi2String,
    format: fmi2String,
    arguments: *mut c_void,
) {
    deliver(environment, || {
        // SAFETY: the caller's promise.
        unsafe {
            LogMessage {
                instance: text(instance),
                status: status.into(),
                category: text(category),
                text: unescaped(&formatted(format, arguments)),
            }
        }
    });
}

/// `fmi3LogMessageCallback`: passes a message to its sink; does not unwind.
///
/// # Safety
/// The strings are NULL or zero-terminated.
pub(crate) unsafe extern "C" fn log_3(
    environment: fmi3InstanceEnvironment,
    status: c_int,
    category: fmi3String,
    message: fmi3String,
) {
    deliver(environment, || {
        // SAFETY: the caller's promise.
        let (category, text) = unsafe { (text(category), text(message)) };
        LogMessage {
            instance: None,
            status: Status::in_version(FmiVersion::Fmi3, status),
            category,
            text: unescaped(&text.unwrap_or_default()),
        }
    });
}

/// A message in which `##` stands for `#`, as both versions want it (FMI 2.0.5, section 2.1.5; FMI 3.0.2, section
/// 2.3.1). References to variables, such as `#3#`, stay as they are.
pub(crate) fn unescaped(text: &str) -> String {
    text.replace("##", "#")
}

/// Passes a message to the sink of an instance; does not unwind.
pub(crate) fn deliver(environment: *mut c_void, logged: impl FnOnce() -> LogMessage) {
    let Some(Callbacks { sink, .. }) = registered(environment) else {
        STRAY.fetch_add(1, Ordering::Relaxed);
        return;
    };
    let logged = logged();
    // C code must not be unwound. The panic hook of the program has reported the panic.
    let _ = catch_unwind(AssertUnwindSafe(move || sink(logged)));
}

fn registered(environment: *mut c_void) -> Option<Callbacks> {
    callbacks().get(&environment.addr()).cloned()
}

/// `fmi3IntermediateUpdateCallback`, which requests no early return; does not unwind.
///
/// # Safety
/// The pointer for the request is NULL or writable.
pub(crate) unsafe extern "C" fn intermediate_update(
    environment: fmi3InstanceEnvironment,
    _: fmi3Float64,
    _: fmi3Boolean,
    _: fmi3Boolean,
    _: fmi3Boolean,
    _: fmi3Boolean,
    early_return_requested: *mut fmi3Boolean,
    _: *mut fmi3Float64,
) {
    pass_update(environment);
    // SAFETY: NULL or the caller's promise.
    if let Some(requested) = unsafe { early_return_requested.as_mut() } {
        *requested = fmi3False;
    }
}

/// Passes an intermediate update to its receiver; does not unwind.
pub(crate) fn pass_update(environment: *mut c_void) {
    call_back(registered(environment).and_then(|callbacks| callbacks.intermediate));
}

/// `fmi3ClockUpdateCallback`: passes an update of clocks to its receiver; does not unwind.
pub(crate) unsafe extern "C" fn clock_update(environment: fmi3InstanceEnvironment) {
    call_back(registered(environment).and_then(|callbacks| callbacks.clock_update));
}

fn call_back(receiver: Option<OnIntermediate>) {
    if let Some(callback) = receiver {
        // C code must not be unwound.
        let _ = catch_unwind(AssertUnwindSafe(move || callback()));
    }
}

// On Windows, the `printf` family is inline in the headers of the C library; this library has it.
#[cfg_attr(all(windows, target_env = "msvc"), link(name = "legacy_stdio_definitions"))]
unsafe extern "C" {
    /// Each ABI of [`entry`] passes a `va_list` as a pointer, to itself or to
    /// the arguments.
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
    // The last byte stays zero, as some C libraries do not terminate a truncated string.
    // SAFETY: the buffer is larger than the size, and the rest is the caller's promise.
    let length = unsafe { vsnprintf(buffer.as_mut_ptr().cast(), MAX_BYTES - 1, format, arguments) };
    match CStr::from_bytes_until_nul(&buffer) {
        Ok(text) if length >= 0 || !text.is_empty() => owned(text),
        // SAFETY: the caller's promise.
        _ => unsafe { text(format) }.unwrap_or_default(),
    }
}

/// The string behind a pointer; `None` for NULL.
///
/// # Safety
/// `pointer` is NULL or points to a zero-terminated string.
pub(crate) unsafe fn text(pointer: *const c_char) -> Option<String> {
    if pointer.is_null() {
        return None;
    }
    // SAFETY: not NULL by the check, and a C string by the caller's promise.
    Some(owned(unsafe { CStr::from_ptr(pointer) }))
}

/// A copy, in which characters replace what is not UTF-8. Text that needs no replacement, as nearly all does, is
/// found faster.
fn owned(text: &CStr) -> String {
    text.to_str().map_or_else(|_| text.to_string_lossy().into_owned(), str::to_owned)
}

/// The logger passed to FMUs.
pub(crate) fn logger() -> fmi2CallbackLogger {
    // SAFETY: `entry` follows the calling convention of this variadic type.
    unsafe { std::mem::transmute(entry as *const ()) }
}

/// System V: `al` tells whether floating-point numbers are passed in registers. A `va_list` consists of
/// two offsets into a copy of the registers (5 integers are named arguments), a pointer to the arguments
/// on the stack, and a pointer to the copy.
#[cfg(all(target_arch = "x86_64", not(windows)))]
#[unsafe(naked)]
unsafe extern "C" fn entry() {
    std::arch::naked_asm!(
        "push rbp",
        "mov rbp, rsp",
        "sub rsp, 208",
        "mov [rsp + 40], r9",
        "test al, al",
        "je 2f",
        "movaps [rsp + 48], xmm0",
        "movaps [rsp + 64], xmm1",
        "movaps [rsp + 80], xmm2",
        "movaps [rsp + 96], xmm3",
        "movaps [rsp + 112], xmm4",
        "movaps [rsp + 128], xmm5",
        "movaps [rsp + 144], xmm6",
        "movaps [rsp + 160], xmm7",
        "2:",
        "mov dword ptr [rsp + 176], 40",
        "mov dword ptr [rsp + 180], 48",
        "lea rax, [rbp + 16]",
        "mov [rsp + 184], rax",
        "mov [rsp + 192], rsp",
        "lea r9, [rsp + 176]",
        "call {log}",
        "leave",
        "ret",
        log = sym log,
    )
}

/// Windows: arguments after the fourth are consecutive on the stack; a `va_list` points to the first
/// variadic argument. The instance name is not needed, so its register passes a pointer to the fifth
/// argument.
#[cfg(all(target_arch = "x86_64", windows))]
#[unsafe(naked)]
unsafe extern "C" fn entry() {
    unsafe extern "C" fn unpack(
        environment: *mut c_void,
        stack: *mut fmi2String,
        status: c_int,
        category: fmi2String,
    ) {
        // SAFETY: the stack has the message and the variadic arguments, as passed to the logger.
        unsafe {
            let (none, arguments) = (ptr::null(), stack.add(1).cast());
            log(environment, none, status, category, *stack, arguments);
        }
    }

    std::arch::naked_asm!("lea rdx, [rsp + 40]", "jmp {unpack}", unpack = sym unpack)
}

/// AAPCS64: a `va_list` consists of a pointer to the arguments on the stack, pointers to the ends of
/// copies of the integer and floating-point registers, and the negated number of bytes left in each.
#[cfg(all(target_arch = "aarch64", not(windows), not(target_vendor = "apple")))]
#[unsafe(naked)]
unsafe extern "C" fn entry() {
    std::arch::naked_asm!(
        "stp x29, x30, [sp, #-208]!",
        "mov x29, sp",
        "stp x5, x6, [sp, #56]",
        "str x7, [sp, #72]",
        "stp q0, q1, [sp, #80]",
        "stp q2, q3, [sp, #112]",
        "stp q4, q5, [sp, #144]",
        "stp q6, q7, [sp, #176]",
        "add x9, sp, #208",
        "add x10, sp, #80",
        "stp x9, x10, [sp, #16]",
        "str x9, [sp, #32]",
        "mov w11, #-24",
        "mov w12, #-128",
        "stp w11, w12, [sp, #40]",
        "add x5, sp, #16",
        "bl {log}",
        "ldp x29, x30, [sp], #208",
        "ret",
        log = sym log,
    )
}

/// Apple: variadic arguments are on the stack; a `va_list` points to the first of them.
#[cfg(all(target_arch = "aarch64", target_vendor = "apple"))]
#[unsafe(naked)]
unsafe extern "C" fn entry() {
    std::arch::naked_asm!("mov x5, sp", "b {log}", log = sym log)
}

/// Other ABIs: only the named arguments are read, and messages stay unformatted.
#[cfg(not(any(target_arch = "x86_64", all(target_arch = "aarch64", not(windows)))))]
unsafe extern "C" fn entry(
    environment: *mut c_void,
    instance: fmi2String,
    status: c_int,
    category: fmi2String,
    format: fmi2String,
) {
    // SAFETY: the caller's promise.
    unsafe {
        let none = ptr::null_mut();
        log(environment, instance, status, category, format, none)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The type of the logger, with an arbitrary integer as the status.
    type Logger = unsafe extern "C" fn(
        fmi2ComponentEnvironment,
        fmi2String,
        c_int,
        fmi2String,
        fmi2String,
        ...
    );

    fn c_logger() -> Logger {
        // SAFETY: a status is a C integer.
        unsafe { std::mem::transmute(logger()) }
    }

    type Received = Arc<Mutex<Vec<LogMessage>>>;

    fn received() -> (Received, Registered) {
        let received = Received::default();
        let sink = Arc::clone(&received);
        let sink = Arc::new(move |logged| sink.lock().unwrap().push(logged));
        (received, Registered::new(sink, None))
    }

    /// Logs a status and a format with arguments, and returns the received message.
    macro_rules! logged {
        ($status:literal $category:expr, $format:expr $(, $argument:expr)*) => {{
            let (received, registered) = received();
            let (environment, category): (_, *const c_char) = (registered.environment(), $category);
            // SAFETY: the strings are NULL or zero-terminated, and the arguments match the format.
            unsafe { c_logger()(environment, ptr::null(), $status, category, $format $(, $argument)*) };
            let mut received = received.lock().unwrap();
            assert_eq!(received.len(), 1);
            received.remove(0)
        }};
        ($format:expr $(, $argument:expr)*) => {
            logged!(1 c"c".as_ptr(), CStr::as_ptr($format) $(, $argument)*)
        };
    }

    #[test]
    fn arguments_in_registers_and_on_the_stack_are_formatted() {
        let (a, b) = (c"text".as_ptr(), c"other".as_ptr());
        let none = logged!(c"100%% plain");
        assert_eq!((none.status, none.category.as_deref()), (Status::Warning, Some("c")));
        assert_eq!(none.text, "100% plain");
        assert_eq!(logged!(c"%s=%d #3# ##%d", a, -7, 1).text, "text=-7 #3# #1");
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
        assert_eq!(logged!(c"%*d|%.*f|%c", 5, 42, 2, 1.0 / 3.0, 65).text, "   42|0.33|A");
    }

    #[test]
    fn long_messages_are_truncated_and_invalid_utf_8_is_replaced() {
        let long = std::ffi::CString::new("x".repeat(100_000)).unwrap();
        assert_eq!(logged!(c"%s", long.as_ptr()).text, "x".repeat(4094));
        assert_eq!(logged!(c"%s", c"caf\xe9 1".as_ptr()).text, "caf\u{fffd} 1");
    }

    #[test]
    fn the_status_may_be_any_integer_and_strings_may_be_null() {
        let known = logged!(42 ptr::null(), c"m".as_ptr());
        assert_eq!((known.status, &*known.text), (Status::Unknown(42), "m"));
        let null = logged!(-1 ptr::null(), ptr::null());
        assert_eq!((null.status, &*null.text), (Status::Unknown(-1), ""));
    }

    #[test]
    fn messages_from_other_threads_arrive_and_those_of_freed_instances_are_ignored() {
        let (received, registered) = received();
        let (log, key) = (c_logger(), registered.environment().addr());
        let log_once = move || {
            let environment = ptr::without_provenance_mut(key);
            // SAFETY: the format needs one integer.
            unsafe { log(environment, ptr::null(), 0, ptr::null(), c"%d".as_ptr(), 1) }
        };
        std::thread::spawn(log_once).join().unwrap();
        drop(registered);
        log_once();
        assert_eq!(received.lock().unwrap().len(), 1);
    }

    #[test]
    fn a_panic_in_the_sink_does_not_reach_the_fmu() {
        let registered = Registered::new(Arc::new(|_| panic!("in the sink")), None);
        let (environment, none) = (registered.environment(), ptr::null());
        // SAFETY: the format needs no arguments.
        unsafe { c_logger()(environment, none, 0, none, c"m".as_ptr()) };
    }
}
