//! The logger as a variadic function, which stable Rust can call but not define: for each ABI, a few
//! instructions that build a `va_list` from the arguments and pass it to [`log`](crate::logger::log) as
//! the sixth argument.

#![allow(unused_imports, reason = "not every ABI uses all of them")]

use std::ffi::c_int;

use fmi_abi::fmi2::{fmi2CallbackLogger, fmi2String};

use crate::logger::log;

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
        environment: *mut std::ffi::c_void,
        stack: *mut fmi2String,
        status: c_int,
        category: fmi2String,
    ) {
        // SAFETY: the stack has the message and the variadic arguments, as passed to the logger.
        unsafe {
            let arguments = stack.add(1).cast();
            log(
                environment,
                std::ptr::null(),
                status,
                category,
                *stack,
                arguments,
            );
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
    environment: *mut std::ffi::c_void,
    instance: fmi2String,
    status: c_int,
    category: fmi2String,
    format: fmi2String,
) {
    // SAFETY: the caller's promise.
    unsafe {
        log(
            environment,
            instance,
            status,
            category,
            format,
            std::ptr::null_mut(),
        )
    }
}
