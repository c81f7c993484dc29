//! Forwards messages to the host's logger.

use std::ffi::{CString, c_int};

use super::{fmi3InstanceEnvironment, fmi3LogMessageCallback, fmi3Status};
use crate::log::{Category, Sink};

/// Creates a sink for the host's logger, if the host provides one.
pub(super) fn sink(
    environment: fmi3InstanceEnvironment,
    log_message: Option<fmi3LogMessageCallback>,
) -> Option<Sink> {
    let log_message = log_message?;
    Some(Box::new(move |category, message| {
        // A zero byte would end the text early. Our messages have none, but they may quote names from
        // the host. `#` introduces a value reference (FMI 3.0.2, section 2.3.1).
        let text = message.replace('\0', " ").replace('#', "##");
        let text = CString::new(text).unwrap_or_default();
        let status = status(category) as c_int;
        // SAFETY: the host provides this function to be called with these C types (FMI 3.0.2, section
        // 2.3.1); the strings are zero-terminated and outlive the call.
        unsafe { log_message(environment, status, category.name().as_ptr(), text.as_ptr()) };
    }))
}

fn status(category: Category) -> fmi3Status {
    match category {
        Category::Error => fmi3Status::fmi3Error,
        Category::Warning => fmi3Status::fmi3Warning,
        Category::Discard => fmi3Status::fmi3Discard,
        Category::Fatal => fmi3Status::fmi3Fatal,
        Category::Events => fmi3Status::fmi3OK,
    }
}
