//! Which faults happen at which calls, and what has happened.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use super::{Effect, Fault};
use crate::config::Runtime;
use crate::handle;
use crate::instance::Instance;

/// Plans in this process that want to hear of calls: where there is none, a call asks for nothing more than this.
static PLANS: AtomicUsize = AtomicUsize::new(0);

/// Faults, and the calls so far. Clones are the same plan, so that the calls of a run are counted over all of its
/// instances. The default plan has no faults and counts nothing.
#[derive(Clone, Debug, Default)]
pub struct FaultPlan(Option<Arc<Watched>>);

#[derive(Debug)]
struct Watched {
    faults: Vec<Fault>,
    done: Mutex<Done>,
}

#[derive(Debug, Default)]
struct Done {
    calls: BTreeMap<&'static str, u64>,
    hits: Vec<Hit>,
}

/// More hits than anybody reads.
const HITS_KEPT: usize = 1000;

/// A fault that has happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Hit {
    /// The entry point.
    pub entry_point: &'static str,
    /// Which of its calls, counted from 1.
    pub call: u64,
    /// What it did: a code, a bad value, or `HANG`.
    pub what: String,
}

impl FaultPlan {
    /// A plan; also one without faults counts calls.
    pub fn new(faults: impl IntoIterator<Item = Fault>) -> Self {
        PLANS.fetch_add(1, Ordering::Relaxed);
        Self(Some(Arc::new(Watched { faults: faults.into_iter().collect(), done: Mutex::default() })))
    }

    /// Whether nothing is planned.
    pub fn is_empty(&self) -> bool {
        self.0.as_ref().is_none_or(|watched| watched.faults.is_empty())
    }

    /// What is planned.
    pub fn faults(&self) -> &[Fault] {
        self.0.as_ref().map_or(&[], |watched| &watched.faults)
    }

    /// How often each entry point was called.
    pub fn calls(&self) -> BTreeMap<&'static str, u64> {
        self.0.as_ref().map(|watched| watched.done().calls.clone()).unwrap_or_default()
    }

    /// What has happened, in its order; the first thousand.
    pub fn hits(&self) -> Vec<Hit> {
        self.0.as_ref().map(|watched| watched.done().hits.clone()).unwrap_or_default()
    }

    /// Counts a call and says what happens to it. Of several faults the first holds.
    fn on_call(&self, entry_point: &'static str) -> Option<Effect> {
        let watched = self.0.as_ref()?;
        let mut done = watched.done();
        let count = done.calls.entry(entry_point).or_default();
        *count += 1;
        let call = *count;
        let effect = watched.faults.iter().find(|fault| fault.holds(entry_point, call))?.effect;
        log::info!("{entry_point}, call {call}: fault {}", effect.name());
        if done.hits.len() < HITS_KEPT {
            done.hits.push(Hit { entry_point, call, what: effect.name() });
        }
        Some(effect)
    }
}

impl Watched {
    fn done(&self) -> std::sync::MutexGuard<'_, Done> {
        self.done.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Watched {
    fn drop(&mut self) {
        PLANS.fetch_sub(1, Ordering::Relaxed);
    }
}

/// What happens to a call of `entry_point` whose first argument is the handle `of` (0 where it has none: then the plan
/// is the one of the calling thread's configuration).
pub(crate) fn effect(entry_point: &'static str, of: u64) -> Option<Effect> {
    if PLANS.load(Ordering::Relaxed) == 0 {
        return None;
    }
    if of == 0 {
        return Runtime::configured().faults.on_call(entry_point);
    }
    handle::root::<Instance>(of)?.config.faults.on_call(entry_point)
}

/// Never returns.
pub(crate) fn hang(entry_point: &str) -> ! {
    log::warn!("{entry_point} does not return: a fault that was asked for");
    loop {
        std::thread::park_timeout(Duration::from_secs(3600));
    }
}
