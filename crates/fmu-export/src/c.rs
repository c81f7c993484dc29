//! Global variables of C code, of which each instance has its own copy.

use std::fmt::{self, Debug, Formatter};
use std::marker::PhantomData;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use serde_core::de::Error;
use serde_core::{Deserialize, Deserializer, Serialize, Serializer};

/// The global variables of a C library as an instance sees them: a field of a model, which is reset, copied and saved
/// with it.
///
/// The build script compiles the library with `fmu_cc::isolate`, and [`c_library!`](crate::c_library) names it:
///
/// ```ignore
/// fmu_export::c_library!(Heater = "heater");
///
/// unsafe extern "C" {
///     static mut heater_u: f64;
///     fn heater_step();
/// }
///
/// # struct Model {
/// code: Globals<Heater>,
/// # }
///
/// // In `step`: calls and variables of the library are used in `run` only.
/// self.u = self.code.run(|| unsafe {
///     heater_step();
///     heater_u
/// });
/// ```
///
/// The variables of the instance that ran last stay where they are. When another one runs, it copies them to its
/// memory, and its own in their place, so that addresses do not change. Instances on several threads run one after the
/// other. A saved state may contain pointers to variables, constants and functions of the FMU; restored in another
/// process, they are moved with it.
pub struct Globals<L: CLibrary> {
    copy: Arc<Copy>,
    library: PhantomData<fn() -> L>,
}

/// A C library that was compiled with `fmu_cc::isolate`, declared by [`c_library!`](crate::c_library).
pub trait CLibrary: 'static {
    #[doc(hidden)]
    fn library() -> &'static Library;
}

/// Declares a type for the C library that the build script compiles by `fmu_cc::isolate(..., "name")`:
/// `c_library!(Name = "name");`. The type is the parameter of [`Globals`](crate::c::Globals).
#[macro_export]
macro_rules! c_library {
    ($(#[$about:meta])* $vis:vis $name:ident = $library:literal) => {
        $(#[$about])*
        $vis enum $name {}

        impl $crate::c::CLibrary for $name {
            fn library() -> &'static $crate::c::Library {
                unsafe extern "C" {
                    #[link_name = concat!("fmu_c_", $library)]
                    safe fn extent(to: &mut $crate::c::Extent);
                }
                static LIBRARY: $crate::c::Library = $crate::c::Library::new(extent);
                &LIBRARY
            }
        }
    };
}

/// Where the variables are in memory, and the loaded library that contains them, as the code of `fmu-cc` tells.
#[doc(hidden)]
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct Extent {
    start: *mut u8,
    end: *mut u8,
    image_start: *const u8,
    image_end: *const u8,
    /// A hash of the compiled C code.
    code: u64,
}

/// The variables of an instance, while those of another one are in their place.
type Copy = Mutex<Vec<u8>>;

/// The variables of a library, with which one thread at a time works.
#[doc(hidden)]
pub struct Library {
    extent: extern "C" fn(&mut Extent),
    /// Which thread works with them.
    thread: AtomicUsize,
    state: Mutex<State>,
}

struct State {
    /// How many [`Globals`] there are.
    count: usize,
    /// The variables as they were when the FMU was loaded, while there are any [`Globals`].
    initial: Vec<u8>,
    /// Whose variables are in place; those of nobody if the last ones were dropped.
    in_place: Option<Arc<Copy>>,
}

/// Variables as they are saved: the hash of the C code, the layout of the library, the places of addresses in the library,
/// which are saved relative to its start, and the bytes.
type Saved = (u64, [u64; 3], Vec<u32>, Vec<u8>);

type Word = usize;
const WORD: usize = size_of::<Word>();

impl Extent {
    const NONE: Self = Self {
        start: std::ptr::null_mut(),
        end: std::ptr::null_mut(),
        image_start: std::ptr::null(),
        image_end: std::ptr::null(),
        code: 0,
    };

    fn len(&self) -> usize {
        self.end.addr() - self.start.addr()
    }
}

/// A library whose variables no other thread uses.
struct Locked<'a> {
    library: &'a Library,
    extent: Extent,
    state: MutexGuard<'a, State>,
}

impl Library {
    /// `extent` tells where the variables are.
    pub const fn new(extent: extern "C" fn(&mut Extent)) -> Self {
        let state = State { count: 0, initial: Vec::new(), in_place: None };
        Self { extent, thread: AtomicUsize::new(0), state: Mutex::new(state) }
    }

    fn lock(&self) -> Locked<'_> {
        thread_local!(static MARK: u8 = const { 0 });
        let this = MARK.with(|mark| std::ptr::from_ref(mark).addr());
        let state = match self.state.try_lock() {
            Ok(state) => state,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => {
                assert!(
                    self.thread.load(Ordering::Relaxed) != this,
                    "`Globals` of a C library are used within `run` of others of the same library"
                );
                self.state.lock().unwrap_or_else(PoisonError::into_inner)
            }
        };
        self.thread.store(this, Ordering::Relaxed);
        let mut extent = Extent::NONE;
        (self.extent)(&mut extent);
        Locked { library: self, extent, state }
    }
}

impl Drop for Locked<'_> {
    fn drop(&mut self) {
        self.library.thread.store(0, Ordering::Relaxed);
    }
}

impl Locked<'_> {
    /// Copies the variables from their place.
    fn read(&self, to: &mut [u8]) {
        assert_eq!(to.len(), self.extent.len());
        // SAFETY: the linker has put the variables of the library there, whose functions run only under the lock.
        unsafe { std::ptr::copy_nonoverlapping(self.extent.start, to.as_mut_ptr(), to.len()) }
    }

    /// Copies variables to their place.
    fn write(&self, from: &[u8]) {
        assert_eq!(from.len(), self.extent.len());
        // SAFETY: as above; no reference to the variables exists outside the functions.
        unsafe { std::ptr::copy_nonoverlapping(from.as_ptr(), self.extent.start, from.len()) }
    }

    fn is_in_place(&self, copy: &Arc<Copy>) -> bool {
        self.state.in_place.as_ref().is_some_and(|other| Arc::ptr_eq(other, copy))
    }

    /// Puts variables in their place, and those that are there to their copy.
    fn put_in_place(&mut self, copy: &Arc<Copy>) {
        if self.is_in_place(copy) {
            return;
        }
        if let Some(other) = self.state.in_place.take() {
            self.read(&mut bytes(&other));
        }
        self.write(&bytes(copy));
        self.state.in_place = Some(Arc::clone(copy));
    }

    /// Brings a copy up to date.
    fn update(&self, copy: &Arc<Copy>) {
        if self.is_in_place(copy) {
            self.read(&mut bytes(copy));
        }
    }

    /// Counts new variables.
    fn add(&mut self, new: Vec<u8>) -> Arc<Copy> {
        self.state.count += 1;
        Arc::new(Mutex::new(new))
    }
}

fn bytes(copy: &Arc<Copy>) -> MutexGuard<'_, Vec<u8>> {
    copy.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<L: CLibrary> Globals<L> {
    /// Calls functions of the library, and uses its variables, which are those of this instance meanwhile.
    ///
    /// # Panics
    /// It is called within `run` of other globals of the same library.
    pub fn run<R>(&mut self, with: impl FnOnce() -> R) -> R {
        let mut locked = L::library().lock();
        locked.put_in_place(&self.copy);
        with()
    }

    fn with_copy(copy: Arc<Copy>) -> Self {
        Self { copy, library: PhantomData }
    }
}

/// The variables as they were when the FMU was loaded.
impl<L: CLibrary> Default for Globals<L> {
    fn default() -> Self {
        let mut locked = L::library().lock();
        if locked.state.count == 0 {
            let mut initial = vec![0; locked.extent.len()];
            locked.read(&mut initial);
            locked.state.initial = initial;
        }
        let initial = locked.state.initial.clone();
        Self::with_copy(locked.add(initial))
    }
}

impl<L: CLibrary> Clone for Globals<L> {
    fn clone(&self) -> Self {
        let mut locked = L::library().lock();
        locked.update(&self.copy);
        let copy = bytes(&self.copy).clone();
        Self::with_copy(locked.add(copy))
    }

    fn clone_from(&mut self, source: &Self) {
        if Arc::ptr_eq(&self.copy, &source.copy) {
            return;
        }
        let locked = L::library().lock();
        locked.update(&source.copy);
        let from = bytes(&source.copy);
        match locked.is_in_place(&self.copy) {
            true => locked.write(&from),
            false => bytes(&self.copy).copy_from_slice(&from),
        }
    }
}

impl<L: CLibrary> Drop for Globals<L> {
    fn drop(&mut self) {
        let mut locked = L::library().lock();
        if locked.is_in_place(&self.copy) {
            locked.state.in_place = None;
        }
        locked.state.count -= 1;
        if locked.state.count == 0 {
            // As when the FMU was loaded, and without memory.
            let initial = std::mem::take(&mut locked.state.initial);
            locked.write(&initial);
        }
    }
}

impl<L: CLibrary> Debug for Globals<L> {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.debug_struct("Globals").finish_non_exhaustive()
    }
}

impl<L: CLibrary> Serialize for Globals<L> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let locked = L::library().lock();
        locked.update(&self.copy);
        let (mut bytes, mut addresses) = (bytes(&self.copy).clone(), Vec::<u32>::new());
        let image = locked.extent.image_start.addr()..locked.extent.image_end.addr();
        for (place, word) in (0..).step_by(WORD).zip(words(&mut bytes)) {
            let address = Word::from_ne_bytes(*word);
            if image.contains(&address) {
                *word = (address - image.start).to_ne_bytes();
                addresses.push(place);
            }
        }
        let saved: Saved = (locked.extent.code, locked.layout(), addresses, bytes);
        saved.serialize(serializer)
    }
}

impl<'de, L: CLibrary> Deserialize<'de> for Globals<L> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (code, layout, addresses, mut bytes) = Saved::deserialize(deserializer)?;
        let mut globals = Self::default();
        let locked = L::library().lock();
        let Extent { code: own_code, image_start, .. } = locked.extent;
        let is_own = code == own_code && bytes.len() == locked.extent.len();
        if !is_own || !addresses.is_empty() && layout != locked.layout() {
            return Err(D::Error::custom("the variables are of another version of the C code"));
        }
        for place in addresses {
            let word = bytes.get_mut(place as usize..).and_then(|rest| rest.first_chunk_mut());
            if let Some(word) = word {
                let address = Word::from_ne_bytes(*word).wrapping_add(image_start.addr());
                *word = address.to_ne_bytes();
            }
        }
        globals.copy = Arc::new(Mutex::new(bytes));
        Ok(globals)
    }
}

impl Locked<'_> {
    /// What the addresses in saved variables depend on, besides the start of the loaded library.
    fn layout(&self) -> [u64; 3] {
        let Extent { start, image_start, image_end, .. } = self.extent;
        let function = self.library.extent as *const ();
        [start.addr(), image_end.addr(), function.addr()]
            .map(|address| address.wrapping_sub(image_start.addr()) as u64)
    }
}

/// The words of variables; the first one is aligned.
fn words(bytes: &mut [u8]) -> impl Iterator<Item = &mut [u8; WORD]> {
    bytes.as_chunks_mut::<WORD>().0.iter_mut()
}
