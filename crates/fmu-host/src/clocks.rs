//! Clocks of FMI 3.0: their intervals and shifts, and what a host asks for while the FMU updates its clocks.

use std::ffi::c_int;
use std::sync::Arc;

use fmi_abi::FmiVersion;
use fmi_abi::fmi3::*;

use crate::functions::{Fmi3, Handle};
use crate::instance::Instance;
use crate::library::Library;
use crate::observed::CallObserver;
use crate::outcome::{Cause, Failure, Result};
use crate::preemption;

/// What an FMU says of the interval of a clock (FMI 3.0.2, section 2.2.9.4).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IntervalQualifier {
    /// There is no interval yet.
    NotYetKnown = fmi3IntervalNotYetKnown as isize,
    /// The interval is the one that was returned before.
    Unchanged = fmi3IntervalUnchanged as isize,
    /// The interval is a new one.
    Changed = fmi3IntervalChanged as isize,
}

impl IntervalQualifier {
    /// The qualifier that an FMU has returned.
    pub fn of(value: fmi3IntervalQualifier) -> Option<Self> {
        let mut all = [Self::NotYetKnown, Self::Unchanged, Self::Changed].into_iter();
        all.find(|qualifier| *qualifier as c_int == value)
    }

    fn returned_by(function: &'static str, value: fmi3IntervalQualifier) -> Result<Self> {
        let unknown = Cause::Broke("returned an interval qualifier that does not exist");
        Self::of(value).ok_or_else(|| Failure::new(function, unknown))
    }
}

/// A number of intervals of the resolution of a clock: `counter / resolution` seconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct IntervalFraction {
    /// `counter`
    pub counter: u64,
    /// `resolution`, in parts of a second.
    pub resolution: u64,
}

/// No qualifier; the FMU must replace it.
const UNWRITTEN: fmi3IntervalQualifier = -1;

fn interval_decimal(handle: &mut Handle, clock: u32) -> Result<(f64, IntervalQualifier)> {
    let (mut interval, mut qualifier) = ([0.0], [UNWRITTEN]);
    Fmi3(handle).get_interval_decimal(&[clock], &mut interval, &mut qualifier)?;
    let qualifier = IntervalQualifier::returned_by("fmi3GetIntervalDecimal", qualifier[0])?;
    Ok((interval[0], qualifier))
}

fn interval_fraction(
    handle: &mut Handle,
    clock: u32,
) -> Result<(IntervalFraction, IntervalQualifier)> {
    let (mut counter, mut resolution, mut qualifier) = ([0], [0], [UNWRITTEN]);
    Fmi3(handle).get_interval_fraction(&[clock], &mut counter, &mut resolution, &mut qualifier)?;
    let qualifier = IntervalQualifier::returned_by("fmi3GetIntervalFraction", qualifier[0])?;
    Ok((IntervalFraction { counter: counter[0], resolution: resolution[0] }, qualifier))
}

impl Instance {
    /// `fmi3GetIntervalDecimal` of a clock, in s.
    ///
    /// # Errors
    /// As for every call, and if the qualifier does not exist.
    pub fn interval_decimal(&mut self, clock: u32) -> Result<(f64, IntervalQualifier)> {
        interval_decimal(&mut self.handle, clock)
    }

    /// `fmi3GetIntervalFraction` of a clock.
    ///
    /// # Errors
    /// As for every call, and if the qualifier does not exist.
    pub fn interval_fraction(
        &mut self,
        clock: u32,
    ) -> Result<(IntervalFraction, IntervalQualifier)> {
        interval_fraction(&mut self.handle, clock)
    }

    /// `fmi3ActivateModelPartition` of a clock at a time (s). The FMU may update its clocks meanwhile; see
    /// [`Instance::on_clock_update`].
    ///
    /// # Errors
    /// As for every call, and if the FMU returns without unlocking preemption, which is then unlocked.
    pub fn activate_model_partition(&mut self, clock: u32, time: f64) -> Result {
        let activated = Fmi3(&mut self.handle).activate_model_partition(clock, time);
        let kept = preemption::release();
        let broke = Cause::Broke("returned without unlocking preemption");
        activated.and_then(|done| match kept {
            true => Err(Failure::new("fmi3ActivateModelPartition", broke)),
            false => Ok(done),
        })
    }

    /// Has `receive` called whenever the FMU calls `fmi3ClockUpdateCallback`: on the thread of the FMU, during
    /// [`Instance::activate_model_partition`]. Without a receiver, the callback does nothing.
    pub fn on_clock_update(
        &mut self,
        receive: impl Fn(&mut ClockUpdateMode) + Send + Sync + 'static,
    ) {
        let Handle { library, pointer, observer, .. } = &self.handle;
        let (library, observer) = (Arc::clone(library), observer.clone());
        let updating = Updating { library, observer, pointer: *pointer };
        self.registered.on_clock_update(Arc::new(move || receive(&mut updating.mode())));
    }
}

/// An instance whose FMU updates its clocks: the functions that the standard allows meanwhile (FMI 3.0.2, section 5.2).
pub struct ClockUpdateMode(pub(crate) Handle);

impl ClockUpdateMode {
    /// `fmi3GetClock` of output clocks. An activation is returned once.
    ///
    /// # Errors
    /// As for every call: the function is missing or returned a failure status.
    pub fn get_clock(&mut self, clocks: &[u32], values: &mut [fmi3Clock]) -> Result {
        Fmi3(&mut self.0).get_clock(clocks, values)
    }

    /// `fmi3GetIntervalDecimal` of a countdown clock, in s.
    ///
    /// # Errors
    /// As for [`Instance::interval_decimal`].
    pub fn interval_decimal(&mut self, clock: u32) -> Result<(f64, IntervalQualifier)> {
        interval_decimal(&mut self.0, clock)
    }

    /// `fmi3GetIntervalFraction` of a countdown clock.
    ///
    /// # Errors
    /// As for [`Instance::interval_fraction`].
    pub fn interval_fraction(
        &mut self,
        clock: u32,
    ) -> Result<(IntervalFraction, IntervalQualifier)> {
        interval_fraction(&mut self.0, clock)
    }
}

/// The instance that may update its clocks.
struct Updating {
    library: Arc<Library>,
    observer: Option<Arc<dyn CallObserver>>,
    pointer: fmi3Instance,
}

// SAFETY: the pointer is used only when the FMU calls back, on the thread where it does, and the FMU does that while the
// instance exists; afterwards, the callback is no longer registered.
unsafe impl Send for Updating {}
// SAFETY: as above; the standard allows these functions during the call of the same instance that is in progress.
unsafe impl Sync for Updating {}

impl Updating {
    fn mode(&self) -> ClockUpdateMode {
        ClockUpdateMode(Handle {
            library: Arc::clone(&self.library),
            pointer: self.pointer,
            version: FmiVersion::Fmi3,
            observer: self.observer.clone(),
            #[cfg(feature = "sandbox")]
            component: None,
        })
    }
}
