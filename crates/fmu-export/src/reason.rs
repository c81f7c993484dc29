//! Why a call failed: a text for the user, which is made only if somebody hears it.

/// A text that is not made yet.
pub(crate) struct Reason(Box<dyn FnOnce() -> String>);

impl Reason {
    /// The reason that `make` tells.
    pub(crate) fn new(make: impl FnOnce() -> String + 'static) -> Self {
        Self(Box::new(make))
    }

    /// Makes the text.
    pub(crate) fn text(self) -> String {
        (self.0)()
    }
}

impl From<&'static str> for Reason {
    fn from(text: &'static str) -> Self {
        Self::new(move || text.to_owned())
    }
}

/// A [`Reason`] with the arguments of `format!`, which are moved in.
macro_rules! reason {
    ($($format:tt)*) => {
        $crate::reason::Reason::new(move || format!($($format)*))
    };
}

pub(crate) use reason;
