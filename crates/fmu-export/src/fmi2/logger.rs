//! Forwards messages to the host's logger.

use std::ffi::{CStr, CString};

use super::{fmi2CallbackFunctions, fmi2Status};
use crate::log::{Category, Sink};

/// Creates a sink for the host's logger, if the host provides one.
pub(super) fn sink(functions: Option<&fmi2CallbackFunctions>, name: Option<&CStr>) -> Option<Sink> {
    let environment = functions?.componentEnvironment;
    let logger = functions?.logger?;
    let instance = name.map_or_else(CString::default, CStr::to_owned);
    Some(Box::new(move |category, message| {
        // A zero byte would end the text early. Our messages have none, but they may quote names
        // from the host.
        let text = CString::new(message.replace('\0', " ")).unwrap_or_default();
        // SAFETY: the host provides this function to be called with these C types (FMI 2.0.5,
        // section 2.1.5); all strings are zero-terminated and outlive the call; the text is an
        // argument of the format "%s", never the format itself.
        unsafe {
            logger(
                environment,
                instance.as_ptr(),
                status(category),
                category.name().as_ptr(),
                c"%s".as_ptr(),
                text.as_ptr(),
            );
        }
    }))
}

fn status(category: Category) -> fmi2Status {
    match category {
        Category::Error => fmi2Status::fmi2Error,
        Category::Warning => fmi2Status::fmi2Warning,
        Category::Discard => fmi2Status::fmi2Discard,
        Category::Fatal => fmi2Status::fmi2Fatal,
        Category::Events => fmi2Status::fmi2OK,
    }
}
