//! Why a call failed: a message for the user, which is formatted only if its log category is enabled.

/// A message that is formatted on demand.
pub(crate) struct Reason(Box<dyn FnOnce() -> String>);

impl Reason {
    /// Creates a reason with the message that `make` returns.
    pub(crate) fn new(make: impl FnOnce() -> String + 'static) -> Self {
        Self(Box::new(make))
    }

    /// Formats the message.
    pub(crate) fn text(self) -> String {
        (self.0)()
    }
}

impl From<&'static str> for Reason {
    fn from(text: &'static str) -> Self {
        Self::new(move || text.to_owned())
    }
}

/// Creates a [`Reason`] from the arguments of `format!`, which are moved into it.
macro_rules! reason {
    ($($format:tt)*) => {
        $crate::reason::Reason::new(move || format!($($format)*))
    };
}

pub(crate) use reason;
