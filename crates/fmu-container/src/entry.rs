//! Makes entry points of the rows of `fmi-abi`. Those of other interface types than co-simulation refuse the call, as some
//! importers bind all functions.

macro_rules! entries {
    (
        $instance:ident $status:ident
        Free { $($_:tt)* }
        $($group:ident { $($rows:tt)* })*
    ) => {
        $(entries!(@ $group $instance $status $($rows)*);)*
    };
    (
        @ $group:ident $instance:ident $status:ident
        $($name:ident $arguments:tt => $operation:ident in $($states:ident)|+;)*
    ) => {
        $(entry!($group $instance $status $name $arguments $operation);)*
    };
}

macro_rules! entry {
    (ModelExchange $($row:tt)*) => { entry!(@ $($row)*); };
    (ScheduledExecution $($row:tt)*) => { entry!(@ $($row)*); };
    (@ $i:ident $s:ident $name:ident($($arg:ident: $kind:tt),*) $operation:ident) => {
        #[doc = concat!("`", stringify!($name), "`, which returns an error and logs the reason")]
        #[unsafe(no_mangle)]
        pub unsafe extern "C" fn $name(instance: $i, $(_: c_type!($kind)),*) -> $s {
            // SAFETY: the host's promise: NULL or an instance that is not used otherwise.
            let instance = unsafe { instance.cast::<Instance>().as_mut() };
            let refuse = |instance: &mut Instance| {
                instance.call(&calls::$name, |_| Err(refused("a container is for co-simulation only")))
            };
            $s(instance.map_or(Status::Error, refuse) as c_int)
        }
    };
    ($group:ident $i:ident $s:ident $name:ident($($arg:ident: $kind:tt),*) $operation:ident) => {
        #[doc = concat!("`", stringify!($name), "`")]
        #[unsafe(no_mangle)]
        #[allow(unused_variables, reason = "the slices have the lengths")]
        #[allow(unused_mut, reason = "some arguments are pointers that may be NULL")]
        pub unsafe extern "C" fn $name(instance: $i, $($arg: c_type!($kind)),*) -> $s {
            // SAFETY: the host's promises: NULL or an instance that is not used otherwise; pointers that are
            // NULL or valid, those to arrays for the lengths passed with them; zero-terminated texts.
            let status = unsafe {
                let Some(instance) = instance.cast::<Instance>().as_mut() else {
                    return $s(Status::Error as c_int);
                };
                let arguments = || Ok::<_, &str>(($(convert!($arg $kind)?,)*));
                match arguments() {
                    Ok(($(mut $arg,)*)) => {
                        instance.call(&calls::$name, |instance| apply!(instance.$operation [] $($arg: $kind,)*))
                    }
                    Err(why) => instance.call(&calls::$name, |_| Err(refused(why))),
                }
            };
            $s(status as c_int)
        }
    };
}

/// The argument of a host as a Rust type, or why it is refused.
macro_rules! convert {
    ($arg:ident [in? $byte:ty; $n:ident]) => {
        Ok::<_, &str>(slice($arg.cast::<u8>(), $n))
    };
    ($arg:ident [out? $byte:ty; $n:ident]) => {
        Ok::<_, &str>(slice_mut($arg.cast::<u8>(), $n))
    };
    ($arg:ident [in $type:ty; $n:ident]) => {
        slice($arg, $n).ok_or(NULL_ARRAY)
    };
    ($arg:ident [out $type:ty; $n:ident]) => {
        slice_mut($arg, $n).ok_or(NULL_ARRAY)
    };
    ($arg:ident [out? $type:ty]) => {
        Ok::<_, &str>($arg.as_mut())
    };
    ($arg:ident [out $type:ty]) => {
        $arg.as_mut().ok_or("a pointer to a result is NULL")
    };
    ($arg:ident fmi2Boolean) => {
        Ok::<_, &str>($arg != 0)
    };
    ($arg:ident fmi3Boolean) => {
        Ok::<_, &str>($arg != 0)
    };
    ($arg:ident $kind:tt) => {
        Ok::<_, &str>($arg)
    };
}

/// Calls a method with all arguments but the lengths.
macro_rules! apply {
    ($instance:ident.$method:ident [$($done:tt)*]) => { $instance.$method($($done),*) };
    ($instance:ident.$method:ident [$($done:tt)*] $n:ident: [len], $($rest:tt)*) => {
        apply!($instance.$method [$($done)*] $($rest)*)
    };
    ($instance:ident.$method:ident [$($done:tt)*] $arg:ident: [out? $($kind:tt)*], $($rest:tt)*) => {
        apply!($instance.$method [$($done)* ($arg.as_deref_mut())] $($rest)*)
    };
    ($instance:ident.$method:ident [$($done:tt)*] $arg:ident: $kind:tt, $($rest:tt)*) => {
        apply!($instance.$method [$($done)* $arg] $($rest)*)
    };
}
