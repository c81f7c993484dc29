//! The functions that components import.

use std::fs;
use std::path::{Component as Part, Path};
use std::ptr;

use wasmtime::{Caller, Error, Func, FuncType, Memory, Result, Store, Val};

use super::abi;
use super::host_state::HostState;
use crate::logger::{self, LogMessage};
use crate::outcome::Status;

/// The stream of errors; all others are 0.
const STDERR: u32 = 1;

/// A call of a function, as the canonical ABI passes it.
struct ImportCall<'a> {
    caller: Caller<'a, HostState>,
    given: &'a [Val],
    memory: Option<Memory>,
    realloc: Option<Func>,
}

/// The function of an interface, with the memory that it uses.
pub(super) fn function(
    store: &mut Store<HostState>,
    of: FuncType,
    (interface, name): (&str, &str),
    (memory, realloc): (Option<Memory>, Option<Func>),
) -> Func {
    let (interface, name) = (interface.to_owned(), name.to_owned());
    Func::new(store, of.clone(), move |caller, given, results| {
        for (result, of) in results.iter_mut().zip(of.results()) {
            *result = match name.as_str() {
                "get-stderr" => Val::I32(STDERR.cast_signed()),
                _ => Val::default_for_ty(&of).ok_or_else(|| Error::msg("a type is unknown"))?,
            };
        }
        let mut call = ImportCall { caller, given, memory, realloc };
        match interface.strip_prefix("fmi:fmi3/") {
            Some(_) => call.perform(&name),
            None => call.grant_nothing(&name),
        }
        .and_then(|is_known| match is_known {
            true => Ok(()),
            false => {
                Err(Error::msg(format!("it calls {name} of {interface}, which is not granted")))
            }
        })
    })
}

impl ImportCall<'_> {
    /// Performs a function of the draft. Returns whether it is one.
    fn perform(&mut self, name: &str) -> Result<bool> {
        match name {
            "log-message" => {
                let (instance, status) = (Some(self.text(0)?), abi::status(self.word(2)?)?);
                let (category, text) = (Some(self.text(3)?), logger::unescaped(&self.text(5)?));
                let status = Status::from(status.0);
                self.caller.data().log(LogMessage { instance, status, category, text });
            }
            // It cannot be called while it waits, when the host would ask for its clocks.
            "clock-update" => {
                return Err(Error::msg(
                    "it has news about clocks, for which this host cannot ask a component",
                ));
            }
            "lock-preemption" | "unlock-preemption" => {}
            "intermediate-update" => {
                logger::pass_update(ptr::without_provenance_mut(self.caller.data().callbacks));
                // It requests no early return.
                self.put(5, 0, &[0; 16])?;
            }
            "read-file" => {
                let content = read(&self.caller.data().resources, &self.text(0)?);
                let tag = u8::from(content.is_err());
                let content = content.unwrap_or_else(String::into_bytes);
                self.put(2, 0, &[tag])?;
                self.put_list(2, 4, &content)?;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// Performs a WASI function, as components compiled for `wasm32-wasip2` import them; nothing is granted. Lines that it prints become messages. Results are 0, which is an empty text or list, none or
    /// success. Returns whether that is a sensible returned.
    fn grant_nothing(&mut self, name: &str) -> Result<bool> {
        match name {
            "get-arguments" | "get-environment" | "get-directories" => self.put_list(0, 0, &[])?,
            "initial-cwd"
            | "get-terminal-stdin"
            | "get-terminal-stdout"
            | "get-terminal-stderr" => {
                self.put(0, 0, &[0])?;
            }
            // Clocks stand still and random numbers are 0, so that a run gives the same results each time.
            "now" | "resolution" => match self.given {
                [] => {}
                _ => self.put(0, 0, &[0; 12])?,
            },
            "insecure-seed" => self.put(0, 0, &[0; 16])?,
            "get-random-bytes" | "get-insecure-random-bytes" => {
                let n = self.given.first().and_then(Val::i64).ok_or_else(mistyped)?;
                match usize::try_from(n) {
                    Ok(n @ ..4096) => self.put_list(1, 0, &vec![0; n])?,
                    _ => return Ok(false),
                }
            }
            "[method]output-stream.write" | "[method]output-stream.blocking-write-and-flush" => {
                let status = if self.word(0)? == STDERR { Status::Warning } else { Status::Ok };
                let printed = self.list(1)?.to_owned();
                self.caller.data_mut().print(status, &printed);
                self.put(3, 0, &[0])?;
            }
            "[method]output-stream.check-write" => {
                self.put(1, 0, &[0])?;
                self.put(1, 8, &4096_u64.to_le_bytes())?;
            }
            "[method]output-stream.flush" | "[method]output-stream.blocking-flush" => {
                self.put(1, 0, &[0])?
            }
            "get-random-u64"
            | "get-insecure-random-u64"
            | "get-stdin"
            | "get-stdout"
            | "get-stderr"
            | "[method]output-stream.subscribe"
            | "[method]pollable.block" => {}
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn word(&self, index: usize) -> Result<u32> {
        let word = self.given.get(index).and_then(Val::i32).ok_or_else(mistyped)?;
        Ok(word.cast_unsigned())
    }

    fn memory(&self) -> Result<Memory> {
        self.memory.ok_or_else(mistyped)
    }

    /// The bytes of a list.
    fn list(&self, index: usize) -> Result<&[u8]> {
        let (at, n) = (self.word(index)?, self.word(index + 1)?);
        abi::bytes(self.memory()?.data(&self.caller), at, n as usize)
    }

    fn text(&self, index: usize) -> Result<String> {
        Ok(abi::text(self.list(index)?)?.to_owned())
    }

    /// Writes to the place of the results, which is an argument.
    fn put(&mut self, index: usize, offset: usize, value: &[u8]) -> Result<()> {
        let place = self.word(index)? as usize + offset;
        Ok(self.memory()?.write(&mut self.caller, place, value)?)
    }

    /// Writes a list to the memory that the component gives for it, and that place to the results.
    fn put_list(&mut self, index: usize, offset: usize, list: &[u8]) -> Result<()> {
        let at = abi::copy(&mut self.caller, (self.memory, self.realloc), list, 1)?;
        self.put(index, offset, &at.to_le_bytes())?;
        self.put(index, offset + 4, &u32::try_from(list.len())?.to_le_bytes())
    }
}

fn mistyped() -> Error {
    Error::msg("it imports a function with other types than in its interface")
}

/// Reads a file in the folder of resources.
fn read(folder: &Path, path: &str) -> std::result::Result<Vec<u8>, String> {
    let is_inside = Path::new(path).components().all(|part| matches!(part, Part::Normal(_)));
    match is_inside {
        true => fs::read(folder.join(path)).map_err(|error| format!("{path}: {error}")),
        false => Err(format!("{path} is not in the folder of resources")),
    }
}
