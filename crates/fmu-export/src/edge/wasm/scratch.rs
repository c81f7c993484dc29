//! Memory for the arguments and results of a call of a component. A host asks for the memory of arguments,
//! and reads the results, before the next call. So all of it is given back at once, and a step does not
//! allocate.

use std::alloc::Layout;
use std::cell::RefCell;

use crate::canonical::{List, Text};

/// Arguments and results that are larger than a block get a block of their own.
const BLOCK: usize = 4096;
/// The largest alignment of a value.
const ALIGNMENT: usize = align_of::<u64>();

/// A smaller one than the standard library's.
#[global_allocator]
static ALLOCATOR: talc::wasm::WasmDynamicTalc = talc::wasm::new_wasm_dynamic_allocator();

struct Scratch {
    /// The last one is in use.
    blocks: Vec<Box<[u64]>>,
    /// Number of bytes in use in the last block.
    used: usize,
    /// Whether nothing in the blocks is needed any more.
    is_over: bool,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> =
        const { RefCell::new(Scratch { blocks: Vec::new(), used: 0, is_over: false }) };
}

impl Scratch {
    fn allocate(&mut self, size: usize, alignment: usize) -> *mut u8 {
        let used = if self.is_over { 0 } else { self.used };
        // A power of two.
        let mask = alignment.clamp(1, ALIGNMENT) - 1;
        let start = (used + mask) & !mask;
        match self.blocks.last_mut() {
            Some(block) if size <= size_of_val(&**block).saturating_sub(start) => {
                (self.used, self.is_over) = (start + size, false);
                block.as_mut_ptr().cast::<u8>().wrapping_add(start)
            }
            _ => self.grow(size),
        }
    }

    /// Adds a block.
    #[cold]
    #[inline(never)]
    fn grow(&mut self, size: usize) -> *mut u8 {
        if self.is_over {
            self.blocks.clear();
        }
        let room = self.blocks.last().map_or(0, |block| size_of_val(&**block));
        let wanted = size.max(2 * room).max(BLOCK);
        self.blocks.push(vec![0; wanted.div_ceil(ALIGNMENT)].into());
        (self.used, self.is_over) = (size, false);
        self.blocks.last_mut().map_or(std::ptr::null_mut(), |block| block.as_mut_ptr()).cast()
    }
}

/// Memory for a value, or for `count` values in a row, until the call after this one.
pub(super) fn allocate<T>(count: usize) -> *mut T {
    let size = Layout::array::<T>(count).map_or(usize::MAX / 2, |layout| layout.size());
    SCRATCH.with_borrow_mut(|scratch| scratch.allocate(size, align_of::<T>())).cast()
}

/// Moves a value there.
pub(super) fn put<T>(value: T) -> *const T {
    let place = allocate::<T>(1);
    // SAFETY: it is memory for a value of this type, aligned for it.
    unsafe { place.write(value) };
    place
}

/// Memory with these bytes, until the next call.
pub(super) fn copied(bytes: &[u8]) -> Text {
    let first = allocate::<u8>(bytes.len());
    // SAFETY: it is memory for as many bytes.
    unsafe { first.copy_from_nonoverlapping(bytes.as_ptr(), bytes.len()) };
    List { first, length: bytes.len() }
}

/// Ends a call, whose results the host reads before it makes another one.
pub(super) fn end() {
    SCRATCH.with_borrow_mut(|scratch| scratch.is_over = true);
}

/// Memory for arguments that hosts may use as often as they like, in place of what [`cabi_realloc`] gives for one call:
/// [`BLOCK`] bytes, a number that `fmu-host` relies on.
#[unsafe(no_mangle)]
extern "C" fn fmu_export_arguments() -> *mut u64 {
    Vec::leak(vec![0; BLOCK / ALIGNMENT]).as_mut_ptr()
}

/// Memory for arguments, by the rules of the canonical ABI.
///
/// # Safety
/// `old` has `old_size` bytes.
#[unsafe(no_mangle)]
unsafe extern "C" fn cabi_realloc(
    old: *const u8,
    old_size: usize,
    alignment: usize,
    size: usize,
) -> *mut u8 {
    let new = SCRATCH.with_borrow_mut(|scratch| scratch.allocate(size, alignment));
    if old_size > 0 {
        // SAFETY: the caller's promise; the new memory is not used otherwise.
        unsafe { new.copy_from(old, old_size.min(size)) };
    }
    new
}
