//! An FMU in a child process that is stepped by hand, with one message for all that a step needs: values that are set
//! wait for the next request, and the values that were got after one step come with the response to the next.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use cargo_fmu::session::Session;
use fmu_description::Value;
use fmu_master::stepped_fmu::{Names, Reply, Request, Response};
use fmu_worker::{Event, Worker};
use pyo3::prelude::*;

use crate::error::to_exception;
use crate::reply::receive;

/// The time that a worker has to free the FMU.
pub const FAREWELL: Duration = Duration::from_secs(2);

/// A worker process with an FMU. The session is dropped after the worker.
pub struct Child {
    worker: Worker,
    _session: Session,
    /// What waits for the next request.
    waiting: Vec<Request>,
    /// The scalars that were got since the last step.
    got: BTreeSet<usize>,
    /// The values of scalars at this moment, as far as they are known here.
    known: BTreeMap<usize, Value>,
}

impl Child {
    /// A worker, which replies when it has instantiated the FMU.
    pub fn new(worker: Worker, session: Session) -> Self {
        let (got, known) = (BTreeSet::new(), BTreeMap::new());
        Self { worker, _session: session, waiting: Vec::new(), got, known }
    }

    /// Sets values together with the next request.
    pub fn set_later(&mut self, values: Vec<(usize, Value)>) {
        self.known.clear();
        self.waiting.push(Request::Set(values));
    }

    /// Forgets what waits for the next request.
    pub fn forget_waiting(&mut self) {
        self.waiting.clear();
    }

    /// Gets the values of scalars.
    pub fn get(
        &mut self,
        py: Python<'_>,
        names: &Names,
        scalars: &[usize],
    ) -> PyResult<Vec<Value>> {
        let known = scalars.iter().map(|scalar| self.known.get(scalar).cloned());
        let known = known.collect::<Option<_>>();
        self.got.extend(scalars);
        match known {
            Some(values) => Ok(values),
            None => match self.request(py, names, Request::Get(scalars.to_vec()))? {
                Response::Values(values) => Ok(values),
                _ => Ok(Vec::new()),
            },
        }
    }

    /// Sends what waits and a request, and returns the response to the request.
    pub fn request(
        &mut self,
        py: Python<'_>,
        names: &Names,
        request: Request,
    ) -> PyResult<Response> {
        self.known.clear();
        let mut requests = std::mem::take(&mut self.waiting);
        let mut wanted = Vec::new();
        if let Request::Step(_) = request {
            wanted.extend(std::mem::take(&mut self.got));
        }
        let place = requests.len();
        requests.push(request);
        if !wanted.is_empty() {
            requests.push(Request::Get(wanted));
        }
        self.worker.send(&requests);
        let Reply { mut responses, failure } = self.receive(py, names)?;
        // That values cannot be got is an error when the user gets them.
        if let (Some(Request::Get(wanted)), Some(Response::Values(values))) =
            (requests.get(place + 1), responses.get_mut(place + 1))
        {
            self.known.extend(wanted.iter().copied().zip(values.drain(..)));
        }
        match (responses.into_iter().nth(place), failure) {
            (Some(response), _) => Ok(response),
            (None, Some(failure)) => Err(to_exception(*failure)),
            (None, None) => Err(crate::error::error(anyhow::anyhow!("a response is missing"))),
        }
    }

    /// Waits for the reply of the worker; Ctrl-C ends the worker.
    pub fn receive(&mut self, py: Python<'_>, names: &Names) -> PyResult<Reply> {
        py.detach(|| receive(&mut self.worker, || vec![names.names()]))
    }

    /// Whether the worker can receive no more requests.
    pub fn has_ended(&mut self) -> bool {
        matches!(self.worker.poll(), Ok(Some(Event::Ended(_))) | Err(_))
    }

    /// Ends the worker.
    pub fn end(mut self) {
        // How it ends no longer matters.
        let _ = self.worker.end(FAREWELL);
    }
}
