//! How components pass arguments and results: the canonical ABI of the component model.

use std::slice;
use std::sync::Arc;

use fmi_abi::fmi3::{fmi3Error, fmi3Status};
use wasmtime::{AsContextMut, Caller, Error, Func, Memory, Result, Store, Val, ValRaw};

use super::host_state::HostState;

const _: () = assert!(cfg!(target_endian = "little"), "memory of components is little-endian");

/// Some bytes of a memory.
pub(super) fn bytes(memory: &[u8], at: u32, n: usize) -> Result<&[u8]> {
    let rest = memory.get(at as usize..).and_then(|rest| rest.get(..n));
    rest.ok_or_else(|| Error::msg(format!("it passed {n} bytes at {at}, which are out of bounds")))
}

/// A text.
pub(super) fn text(bytes: &[u8]) -> Result<&str> {
    Ok(str::from_utf8(bytes)?)
}

/// A status of the draft.
pub(super) fn status(discriminant: u32) -> Result<fmi3Status> {
    match discriminant {
        0..=4 => Ok(fmi3Status(discriminant as i32)),
        _ => Err(unexpected(discriminant)),
    }
}

#[cold]
fn unexpected(discriminant: u32) -> Error {
    Error::msg(format!("it returned the unexpected discriminant {discriminant}"))
}

/// A number that lists consist of.
///
/// # Safety
/// It has no padding, and any bytes are one.
pub(super) unsafe trait Number: Copy {}

macro_rules! numbers {
    ($($type:ident)*) => {
        // SAFETY: these are numbers.
        $(unsafe impl Number for $type {})*
    };
}

numbers! { f32 f64 i8 i16 i32 i64 u8 u16 u32 u64 }

/// A function of a component in a store.
pub(super) struct ComponentFunction {
    /// The types of the component, such as `borrow,list<u32>->status`.
    pub(super) signature: Arc<str>,
    pub(super) function: Func,
    pub(super) memory: Option<Memory>,
    pub(super) realloc: Option<Func>,
    /// Memory for arguments, in place of what `realloc` gives for each call.
    pub(super) arguments: Option<u32>,
    pub(super) post_return: Option<Func>,
}

/// An argument.
pub(super) enum Argument<'a> {
    Whole(u32),
    Float(f64),
    /// The bytes of a list, the number of its elements, and their alignment.
    List(&'a [u8], usize, usize),
    /// The bytes of lists or texts.
    Lists(&'a [&'a [u8]]),
}

impl<'a> Argument<'a> {
    pub(super) fn list<T: Number>(values: &'a [T]) -> Self {
        // SAFETY: a slice of numbers is one of bytes.
        let bytes = unsafe { slice::from_raw_parts(values.as_ptr().cast(), size_of_val(values)) };
        Self::List(bytes, values.len(), size_of::<T>())
    }

    /// A list of pairs of numbers.
    pub(super) fn pairs<T: Number>(values: &'a [T]) -> Self {
        match Self::list(values) {
            Self::List(bytes, n, alignment) => Self::List(bytes, n / 2, alignment),
            other => other,
        }
    }

    pub(super) fn text(text: &'a str) -> Self {
        Self::list(text.as_bytes())
    }

    pub(super) fn option(value: Option<f64>) -> [Self; 2] {
        [Self::Whole(value.is_some().into()), Self::Float(value.unwrap_or_default())]
    }
}

impl From<bool> for Argument<'_> {
    fn from(value: bool) -> Self {
        Self::Whole(value.into())
    }
}

/// Why a call has no result.
pub(super) enum CallError {
    Status(fmi3Status),
    Trap(Error),
}

impl From<Error> for CallError {
    fn from(error: Error) -> Self {
        Self::Trap(error)
    }
}

/// Calls a function, of an instance if one is given, and reads its result.
///
/// # Safety
/// The function has arguments of these types, and no result or one of 32 bits.
#[inline(always)]
pub(super) unsafe fn call<R>(
    store: &mut Store<HostState>,
    function: &ComponentFunction,
    handle: Option<u32>,
    given: &[Argument<'_>],
    read: impl FnOnce(Returned<'_>) -> Result<R, CallError>,
) -> Result<R, CallError> {
    // At most 16 values are passed in this way, and at least one is returned.
    let (mut flat, mut n) = ([ValRaw::u32(0); 16], 0);
    let mut push = |value| {
        flat[n] = value;
        n += 1;
    };
    handle.into_iter().for_each(|handle| push(ValRaw::u32(handle)));
    let mut pass = Passing { function, used: 0 };
    for argument in given {
        match *argument {
            Argument::Whole(value) => push(ValRaw::u32(value)),
            Argument::Float(value) => push(ValRaw::f64(value.to_bits())),
            Argument::List(list, n, alignment) => {
                push(ValRaw::u32(pass.list(store, list, alignment)?));
                push(ValRaw::u32(n as u32));
            }
            Argument::Lists(lists) => {
                let mut places = Vec::new();
                for list in lists {
                    places.extend([pass.list(store, list, 1)?, list.len() as u32]);
                }
                let bytes = Vec::from_iter(places.iter().flat_map(|place| place.to_le_bytes()));
                push(ValRaw::u32(pass.list(store, &bytes, size_of::<u32>())?));
                push(ValRaw::u32(lists.len() as u32));
            }
        }
    }
    // SAFETY: the caller's promise; this is how a component passes these types.
    unsafe { function.function.call_unchecked(&mut *store, &mut flat)? };
    let flat = flat[0].get_u32();
    let memory = function.memory.as_ref().map_or(&[][..], |memory| memory.data(&*store));
    let result = read(Returned { memory, flat });
    if let Some(post_return) = &function.post_return {
        // SAFETY: as above; it gets the result, if there is one.
        unsafe { post_return.call_unchecked(store, &mut [ValRaw::u32(flat)])? };
    }
    result
}

/// The number of bytes for arguments of a call, half of those that `fmu_export_arguments` gives in every component of
/// `fmu-export`. The other half is for the calls of a step.
pub(super) const ARGUMENTS: usize = 2048;

/// The lists of a call.
struct Passing<'a> {
    function: &'a ComponentFunction,
    /// The number of bytes in use of the component's memory for arguments.
    used: usize,
}

impl Passing<'_> {
    /// Copies the bytes of a list to memory that the component gives for it.
    #[inline(always)]
    fn list(&mut self, store: &mut Store<HostState>, list: &[u8], alignment: usize) -> Result<u32> {
        let ComponentFunction { memory, realloc, arguments, .. } = *self.function;
        match arguments {
            Some(start) if list.len() <= ARGUMENTS - self.used => {
                let at = start.saturating_add(self.used as u32);
                self.used = (self.used + list.len()).next_multiple_of(8);
                write(store, memory, at, list)?;
                Ok(at)
            }
            _ => copy(store, (memory, realloc), list, alignment),
        }
    }
}

/// Copies the bytes of a list to memory that a component allocates for it, and returns their place.
pub(super) fn copy(
    mut store: impl AsContextMut,
    (memory, realloc): (Option<Memory>, Option<Func>),
    list: &[u8],
    alignment: usize,
) -> Result<u32> {
    if list.is_empty() {
        return Ok(alignment as u32);
    }
    let size = u32::try_from(list.len())?;
    let mut values = [0, 0, alignment as u32, size].map(ValRaw::u32);
    // SAFETY: the function has these types in each valid component.
    unsafe { realloc.ok_or_else(no_memory)?.call_unchecked(&mut store, &mut values)? };
    let at = values[0].get_u32();
    write(store, memory, at, list)?;
    Ok(at)
}

/// Copies a text from the memory of a component to that of another. Its place, its length, and the place of the copy
/// are given.
pub(super) fn copy_text(
    mut caller: Caller<'_, HostState>,
    given: &[Val],
    from: Memory,
    to: Memory,
) -> Result<()> {
    let [Val::I32(at), Val::I32(n), Val::I32(place)] = *given else { return Err(no_memory()) };
    let [at, n, place] = [at, n, place].map(i32::cast_unsigned);
    let copied = text(bytes(from.data(&caller), at, n as usize)?)?.to_owned();
    write(&mut caller, Some(to), place, copied.as_bytes())
}

/// Writes bytes to a memory.
#[inline(always)]
fn write(mut store: impl AsContextMut, to: Option<Memory>, at: u32, bytes: &[u8]) -> Result<()> {
    let memory = to.ok_or_else(no_memory)?;
    let rest = memory.data_mut(&mut store).get_mut(at as usize..);
    let place = rest.and_then(|rest| rest.get_mut(..bytes.len())).ok_or_else(no_memory)?;
    place.copy_from_slice(bytes);
    Ok(())
}

#[cold]
fn no_memory() -> Error {
    Error::msg("the memory that it gives for arguments is out of bounds")
}

/// What a function returns.
pub(super) struct Returned<'a> {
    memory: &'a [u8],
    /// The result, or its place.
    flat: u32,
}

impl<'a> Returned<'a> {
    /// Nothing but a status.
    pub(super) fn status(&self) -> Result<(), CallError> {
        match status(self.flat)? {
            fmi3Status(0) => Ok(()),
            status => Err(CallError::Status(status)),
        }
    }

    /// The bytes of a result, which comes after the flag that it is one, or in place of a status.
    #[inline(always)]
    pub(super) fn result<const N: usize>(&self, alignment: u32) -> Result<[u8; N], CallError> {
        let payload = self.flat.saturating_add(alignment);
        match self.bytes(self.flat)? {
            [0] => Ok(self.bytes(payload)?),
            [1] => Err(CallError::Status(match status(self.bytes::<1>(payload)?[0].into())? {
                // Without results.
                fmi3Status(0 | 1) => fmi3Error,
                status => status,
            })),
            [other] => Err(unexpected(other.into()).into()),
        }
    }

    /// A value, or nothing.
    pub(super) fn option(&self) -> Result<Option<u32>, CallError> {
        match self.bytes(self.flat)? {
            [0] => Ok(None),
            [1] => Ok(Some(u32::from_le_bytes(self.bytes(self.flat.saturating_add(4))?))),
            [other] => Err(unexpected(other.into()).into()),
        }
    }

    /// Copies the list of a result to values of the host, if there are as many.
    #[inline(always)]
    pub(super) fn copy<T: Number>(&self, to: &mut [T], other: fmi3Status) -> Result<(), CallError> {
        let list = self.list(size_of::<T>())?;
        if list.len() != size_of_val(to) {
            return Err(CallError::Status(other));
        }
        // SAFETY: a slice of numbers is one of bytes, and any bytes are numbers.
        unsafe { slice::from_raw_parts_mut(to.as_mut_ptr().cast(), list.len()) }
            .copy_from_slice(list);
        Ok(())
    }

    /// The bytes of the list of a result, with elements of a size.
    #[inline(always)]
    pub(super) fn list(&self, size: usize) -> Result<&'a [u8], CallError> {
        Ok(self.at(self.result(4)?, size)?)
    }

    /// The lists or texts of the list of a result.
    pub(super) fn lists(&self) -> Result<Vec<&'a [u8]>, CallError> {
        let (lists, _) = self.list(8)?.as_chunks();
        Ok(lists.iter().map(|list| self.at(*list, 1)).collect::<Result<_>>()?)
    }

    /// A text that is not in a result.
    pub(super) fn text(&self) -> Result<&'a str> {
        text(self.at(self.bytes(self.flat)?, 1)?)
    }

    /// The bytes of a list of which the place and the number of elements are given.
    #[inline(always)]
    fn at(&self, list: [u8; 8], size: usize) -> Result<&'a [u8]> {
        let list = u64::from_le_bytes(list);
        bytes(self.memory, list as u32, ((list >> 32) as usize).saturating_mul(size))
    }

    #[inline(always)]
    fn bytes<const N: usize>(&self, at: u32) -> Result<[u8; N]> {
        let mut copy = [0; N];
        copy.copy_from_slice(bytes(self.memory, at, N)?);
        Ok(copy)
    }
}
