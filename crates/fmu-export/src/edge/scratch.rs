//! Memory for the arguments and results of a call of a component. A host asks for the memory of arguments,
//! and reads the results, before the next call. So all of it is given back at once, and a step does not
//! allocate.

use std::alloc::Layout;
use std::cell::RefCell;

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
        if self.is_over {
            // The last block is the largest.
            self.blocks.drain(..self.blocks.len().saturating_sub(1));
            (self.used, self.is_over) = (0, false);
        }
        let room = self.blocks.last().map_or(0, |block| size_of_val(&**block));
        let mut start = self.used.next_multiple_of(alignment.clamp(1, ALIGNMENT));
        if self.blocks.is_empty() || size > room.saturating_sub(start) {
            let wanted = size.max(2 * room).max(BLOCK);
            self.blocks.push(vec![0; wanted.div_ceil(ALIGNMENT)].into());
            start = 0;
        }
        self.used = start + size;
        let block = self.blocks.last_mut().map_or(std::ptr::null_mut(), |block| block.as_mut_ptr());
        block.cast::<u8>().wrapping_add(start)
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

/// Ends a call, whose results the host reads before it makes another one.
pub(super) fn end() {
    SCRATCH.with_borrow_mut(|scratch| scratch.is_over = true);
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
    // SAFETY: the caller's promise; the new memory is not used otherwise.
    unsafe { new.copy_from(old, old_size.min(size)) };
    new
}
