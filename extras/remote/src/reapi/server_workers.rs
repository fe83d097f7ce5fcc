//! The workers of a server, for use by the engine.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bazel_remote_apis::build::bazel::remote::execution::v2 as api;
use cache::Digest;
use engine::{NodeError, Stage, Work, WorkRequest, WorkerTerms, Workers};

use super::call_error::CallError;
use super::execution::{Ended, Execution};
use super::failure::{Failure, failure};
use super::outputs::{ENTRY, Outputs};
use super::sender::Sender;
use super::shared_cache::SharedCache;
use super::work_action::WorkAction;
use super::worker_options::WorkerOptions;

/// Number of nodes in a row that no worker computed, after which no further nodes are sent.
const STRIKES: u32 = 3;
/// Expected time in seconds for an action in addition to its code.
const OVERHEAD: f64 = 0.1;
/// Expected speed of the connection in bytes per second, before any was measured.
const SPEED: f64 = 50e6;

/// The workers of a server.
pub struct ServerWorkers {
    sender: Sender,
    state: Mutex<State>,
    /// True if the canary was right; `None` before it was computed.
    proved: Mutex<Option<bool>>,
}

#[derive(Default)]
struct State {
    /// True if no further nodes are sent.
    stopped: bool,
    /// Number of nodes in a row that no worker computed.
    strikes: u32,
}

/// The result of one attempt.
enum Attempt {
    Work(Work),
    /// The node needs more memory: at least this many bytes, if the worker stated it.
    Memory(Option<u64>),
}

/// The reason why an attempt has no result.
enum Stop {
    Call(CallError),
    /// The node fails, since it must not be computed here.
    Node(NodeError),
}

impl From<CallError> for Stop {
    fn from(error: CallError) -> Self {
        Self::Call(error)
    }
}

impl From<NodeError> for Stop {
    fn from(error: NodeError) -> Self {
        Self::Node(error)
    }
}

impl ServerWorkers {
    /// The workers of the server of `cache`.
    ///
    /// # Errors
    /// If the server executes no actions.
    pub fn new(cache: Arc<SharedCache>, options: WorkerOptions) -> Result<Self, CallError> {
        if !cache.server().executes {
            let why = "the server stores results but executes no actions".to_owned();
            return Err(CallError::Refused { what: "computing nodes", why });
        }
        let sender = Sender::new(cache, options);
        Ok(Self { sender, state: Mutex::default(), proved: Mutex::default() })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// True if the workers computed the canary, and the result was right. The first call waits for it.
    fn is_proved(&self, cancel: &AtomicBool) -> Result<bool, Stop> {
        let Some(canary) = &self.sender.options.canary else { return Ok(true) };
        let mut proved = self.proved.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(proved) = *proved {
            return Ok(proved);
        }
        if self.sender.cache.places.was_proved_today(&canary.key) {
            *proved = Some(true);
            return Ok(true);
        }
        let request = WorkRequest {
            key: canary.key,
            files: &canary.files,
            bytes: &|_| None,
            entry: ENTRY,
            values: &canary.values,
            forecast: None,
            // It is not a result of anybody's graph.
            checked: true,
        };
        let first = self.sender.options.memory.as_ref().and_then(|(_, amounts)| amounts.first().copied());
        let right = match self.attempt(&request, first, cancel, &|_| ())? {
            Attempt::Work(Work::Done { entry, worker }) => {
                let right = entry.blobs().is_ok_and(|values| values == canary.expected);
                if !right {
                    self.distrust(&format!(
                        "{worker} computed a wrong result for a node whose result is known"
                    ));
                }
                right
            }
            // The reason was reported.
            _ => false,
        };
        if right {
            self.sender.cache.places.prove(&canary.key);
        }
        self.state().stopped |= !right;
        *proved = Some(right);
        Ok(right)
    }

    /// Reports why no worker computed a node, which is then computed here. After several nodes in a row, no further
    /// ones are sent.
    fn refuse(&self, id: &'static str, why: &str) -> Result<Work, NodeError> {
        let address = self.sender.cache.address();
        let stops = {
            let mut state = self.state();
            state.strikes += 1;
            let stops = state.strikes >= STRIKES && !state.stopped;
            state.stopped |= stops;
            stops
        };
        if !self.sender.cache.has_fallback() {
            return Err(NodeError::new(format!("no worker of {address} computed the node: {why}"))
                .hint("run without `--no-remote-fallback` to compute such nodes here"));
        }
        let text = format!("{address}: {why}; the node is computed here");
        self.sender.cache.remark(id, format!("{text} (further nodes like this one are not reported)"));
        if stops {
            let text = format!("{address}: {STRIKES} nodes in a row failed; no further nodes are sent there");
            self.sender.cache.remark("remote-stopped", text);
        }
        Ok(Work::Refused)
    }

    /// Sends the inputs of a node and has it executed, again if inputs were lost meanwhile.
    fn attempt(
        &self,
        request: &WorkRequest<'_>,
        memory: Option<u32>,
        cancel: &AtomicBool,
        report: &dyn Fn(Stage),
    ) -> Result<Attempt, Stop> {
        let Some(work) = WorkAction::of(&self.sender, request, memory)? else {
            return Ok(Attempt::Work(Work::Missing));
        };
        for _ in 0..2 {
            report(Stage::Sending);
            if !work.send(&self.sender, request, cancel)? {
                return Ok(Attempt::Work(Work::Missing));
            }
            report(Stage::Queued);
            let execution = Execution {
                action: &work.action,
                priority: self.sender.options.priority,
                inlined: &super::outputs::path(request.entry),
            };
            let result = match self.sender.cache.server().execute(&execution, cancel, report)? {
                Ended::Ran(result) => *result,
                Ended::Missing => continue,
                Ended::TimedOut => {
                    let why = "a node took longer than its time limit";
                    return Ok(Attempt::Work(self.refuse("remote-timeout", why)?));
                }
                Ended::Failed(why) => {
                    return Ok(Attempt::Work(self.refuse("remote-worker", &why)?));
                }
            };
            return self.judge(&result, request, cancel);
        }
        Ok(Attempt::Work(self.refuse("remote-missing", "inputs that were sent are not on the server")?))
    }

    /// The outcome of a command that ended.
    fn judge(
        &self,
        result: &api::ActionResult,
        request: &WorkRequest<'_>,
        cancel: &AtomicBool,
    ) -> Result<Attempt, Stop> {
        let server = self.sender.cache.server();
        // 3 is the code of a degraded result.
        if !matches!(result.exit_code, 0 | 3) {
            let out = server.text(&result.stdout_raw, result.stdout_digest.as_ref(), cancel);
            let err = server.text(&result.stderr_raw, result.stderr_digest.as_ref(), cancel);
            return match failure(result.exit_code, &out, &err) {
                Failure::Node { message, hint } => {
                    self.state().strikes = 0;
                    Ok(Attempt::Work(Work::Failed { message, hint }))
                }
                Failure::Memory(needs) => Ok(Attempt::Memory(needs)),
                Failure::Worker(why) => Ok(Attempt::Work(self.refuse("remote-worker", &why)?)),
            };
        }
        let Outputs { entry, places } = match server.outputs(result, request, cancel)? {
            Ok(outputs) => outputs,
            Err(why) => {
                let why = format!("the outputs of a worker are refused: {why}");
                return Ok(Attempt::Work(self.refuse("remote-invalid", &why)?));
            }
        };
        for (value, place) in &places {
            self.sender.cache.places.put(*value, place.clone());
        }
        self.state().strikes = 0;
        self.sender.cache.count(|traffic| traffic.executed += 1);
        if !request.checked {
            self.sender.cache.publish_entry(&entry, &places, cancel);
        }
        let named = result.execution_metadata.as_ref().map(|metadata| metadata.worker.as_str());
        let worker = match named.unwrap_or_default() {
            "" => format!("a worker of {}", self.sender.cache.address()),
            name => format!("the worker `{name}` of {}", self.sender.cache.address()),
        };
        Ok(Attempt::Work(Work::Done { entry: Box::new(entry), worker }))
    }

    /// The amount of memory in GiB to ask for after a worker had too little; `None` if there is no larger one.
    fn more_memory(&self, had: Option<u32>, needs: Option<u64>) -> Option<u32> {
        let (_, amounts) = self.sender.options.memory.as_ref()?;
        let enough = |gib: u32| needs.is_none_or(|needs| u64::from(gib) << 30 >= needs);
        amounts.iter().copied().find(|gib| had.is_none_or(|had| *gib > had) && enough(*gib))
    }
}

impl Workers for ServerWorkers {
    fn terms(&self) -> Option<WorkerTerms> {
        let state = self.state();
        if state.stopped || self.sender.cache.is_lost() {
            return None;
        }
        let speed = self.sender.speed().unwrap_or(SPEED);
        let WorkerOptions { in_flight, checked, .. } = self.sender.options;
        Some(WorkerTerms { in_flight, overhead: OVERHEAD, speed, checked })
    }

    fn holds(&self, value: &Digest) -> bool {
        self.sender.cache.places.get(value).is_some()
    }

    fn compute(
        &self,
        request: &WorkRequest<'_>,
        cancel: &AtomicBool,
        report: &dyn Fn(Stage),
    ) -> Result<Work, NodeError> {
        if let Some(lost) = self.sender.cache.without::<()>() {
            return lost.map(|_| Work::Refused);
        }
        let first = self.sender.options.memory.as_ref().and_then(|(_, amounts)| amounts.first().copied());
        let attempt = |memory| match self.is_proved(cancel)? {
            true => self.attempt(request, memory, cancel, report),
            false => Ok(Attempt::Work(Work::Refused)),
        };
        let outcome = attempt(first).and_then(|outcome| match outcome {
            Attempt::Work(work) => Ok(Attempt::Work(work)),
            Attempt::Memory(needs) => match self.more_memory(first, needs) {
                Some(more) => attempt(Some(more)),
                None => Ok(Attempt::Memory(needs)),
            },
        });
        match outcome {
            Ok(Attempt::Work(work)) => Ok(work),
            Ok(Attempt::Memory(_)) => {
                self.refuse("remote-memory", "a node needs more memory than the workers have")
            }
            Err(Stop::Node(error)) => Err(error),
            Err(Stop::Call(CallError::Cancelled)) => Err(NodeError::cancelled()),
            Err(Stop::Call(error @ (CallError::Refused { .. } | CallError::Wrong { .. }))) => {
                self.refuse("remote-refused", &error.to_string())
            }
            Err(Stop::Call(error)) => self.sender.cache.failed::<()>(&error).map(|_| Work::Refused),
        }
    }

    fn distrust(&self, why: &str) {
        self.state().stopped = true;
        let address = self.sender.cache.address();
        self.sender
            .cache
            .remark("remote-differs", format!("{address}: {why}; no further nodes are sent there"));
    }
}
