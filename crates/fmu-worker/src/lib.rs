//! Runs foreign code, such as the binary of an FMU, in child processes, since it may crash, exit, hang or
//! fill the memory.
//!
//! A supervisor starts its own program again as a [`Worker`] and sends it tasks. In the worker,
//! [`Service::from_env`] receives the tasks and replies. Both are any types with `serde`. Before
//! each call of a foreign function, the worker notes it in a [`Record`]. All of this is in memory that the
//! two processes share: when a worker has [`Ended`] early, because of a crash or a limit, the supervisor has
//! all its replies and reads which call it was.
//!
//! ```no_run
//! use std::process::Command;
//! use std::time::Duration;
//!
//! use fmu_worker::{Event, Function, Limits, Service, Worker};
//!
//! if let Some(mut service) = Service::from_env()? {
//!     let mut calls = service.record().calls(0);
//!     while let Some(number) = service.task::<u64>()? {
//!         calls.begin(Function::named("fmi2DoStep"));
//!         let square = number * number; // by a foreign function
//!         service.record().end_call();
//!         service.reply(&square);
//!     }
//!     return Ok(());
//! }
//!
//! let session = std::path::Path::new("session");
//! let limits = Limits { call: Some(Duration::from_secs(20)), ..Limits::default() };
//! let mut worker = Worker::start(&mut Command::new(std::env::current_exe()?), session, limits)?;
//! worker.send(&12);
//! match worker.wait()? {
//!     Event::Replied => println!("{}", worker.reply::<u64>()?),
//!     Event::Ended(ended) => println!("{:?} {ended}", worker.record().snapshot().function),
//! }
//! # std::io::Result::Ok(())
//! ```
#![forbid(unsafe_code)]

mod channel;
mod record;
mod supervisor;
mod worker;

pub use fmu_host::ProcessOwned;
pub use fmu_host::real_time::RealTimeThread;
pub use record::{Call, Calls, Function, MAX_THREADS, Record, Snapshot};
pub use supervisor::{Ended, Event, Limits, SLOW, Worker, available_memory};
pub use worker::Service;
