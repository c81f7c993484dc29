//! The functions that C sources call, which are written in C.

use std::ffi::{c_char, c_int};
use std::path::Path;
use std::ptr::null;

#[cfg(not(feature = "fmi2"))]
use fmi_abi::fmi3::*;

use crate::pointers::c_text;
use crate::resources::Folder;

#[link(wasm_import_module = "fmu")]
unsafe extern "C" {
    pub(crate) fn log(status: c_int, category: *const c_char, message: *const c_char);
    /// The size of a resource, by its path and its name in the folder of resources; negative if it cannot be read.
    /// The path is NULL if the host passed no folder.
    fn resource_size(path: *const c_char, name: *const c_char) -> i32;
    /// Reads a resource of this size. Returns 0 if all was read.
    #[link_name = "read_resource"]
    fn read_bytes(path: *const c_char, name: *const c_char, content: *mut u8, size: usize) -> i32;
    /// Returns whether the host requests an early return, whose time it writes.
    #[cfg(not(feature = "fmi2"))]
    fn intermediate_update(
        time: f64,
        set_requested: c_int,
        get_allowed: c_int,
        step_finished: c_int,
        can_return_early: c_int,
        return_time: *mut f64,
    ) -> c_int;
    /// Lets the host ask for clocks.
    #[cfg(all(not(feature = "fmi2"), feature = "scheduled-execution"))]
    fn clock_update();
}

/// The callback of FMI 3.0 for updates of clocks.
#[cfg(all(not(feature = "fmi2"), feature = "scheduled-execution"))]
pub(crate) unsafe extern "C" fn update_clocks(_environment: fmi3InstanceEnvironment) {
    // SAFETY: the host provides this function.
    unsafe { clock_update() };
}

/// The callback of FMI 3.0 for intermediate updates.
#[cfg(not(feature = "fmi2"))]
pub(crate) unsafe extern "C" fn call_back(
    _environment: fmi3InstanceEnvironment,
    time: f64,
    set_requested: fmi3Boolean,
    get_allowed: fmi3Boolean,
    step_finished: fmi3Boolean,
    can_return_early: fmi3Boolean,
    early_return: *mut fmi3Boolean,
    return_time: *mut f64,
) {
    let [set_requested, get_allowed, step_finished, can_return_early] =
        [set_requested, get_allowed, step_finished, can_return_early].map(c_int::from);
    // SAFETY: the host provides this function; the caller's promise: valid pointers.
    unsafe {
        let is_requested = intermediate_update(
            time,
            set_requested,
            get_allowed,
            step_finished,
            can_return_early,
            return_time,
        );
        *early_return = (is_requested != 0).into();
    }
}

/// Reads a resource by the host, which has the files.
pub(crate) fn read_resource(folder: &Folder, name: &Path) -> Result<String, String> {
    let text = |path: &Path| path.to_str().map(c_text).ok_or("its name is not UTF-8");
    let folder = folder.path();
    let path = folder.as_ref().map(|folder| text(&folder.join(name)));
    let (path, name) = (path.ok().transpose()?, text(name)?);
    let path = path.as_ref().map_or(null(), |path| path.as_ptr());
    // SAFETY: the host provides these functions; the texts and the memory for the content outlive the calls.
    let bytes = unsafe {
        let size = usize::try_from(resource_size(path, name.as_ptr()));
        let size = size.map_err(|_| match &folder {
            Ok(folder) => format!("there is no such file in {}", folder.display()),
            Err(reason) => reason.clone(),
        })?;
        let mut bytes = Vec::new();
        bytes.try_reserve_exact(size).map_err(|_| format!("no memory for its {size} bytes"))?;
        bytes.resize(size, 0);
        match read_bytes(path, name.as_ptr(), bytes.as_mut_ptr(), size) {
            0 => bytes,
            _ => return Err("it cannot be read".into()),
        }
    };
    String::from_utf8(bytes).map_err(|error| error.to_string())
}
