//! The workers of a process: which command may be executed, and which worker an environment goes to.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::error::Error;
use crate::launch::WorkerLaunch;
use crate::link::WorkerLink;
use crate::pickle::check_pickle;
use crate::settings::{PythonSettings, SnapshotKind, WorldSpec};

/// Which command a process executes to step environments.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Permission {
    /// None: the configuration came from somebody else.
    #[default]
    Refused,
    /// The configuration's: it is this user's own, or one that they trust.
    Configured,
    /// This one, instead of the configuration's.
    Own(String),
}

/// What a process does with workers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct WorkerRules {
    /// Which command is executed.
    pub permission: Permission,
    /// Snapshots come from other processes, which this one does not trust: reading a pickle may execute anything.
    pub refuses_pickles: bool,
    /// Workers are started while an environment is built, so that what is wrong with them is reported at once.
    pub starts_at_once: bool,
    /// The fewest workers for every kind of environment.
    pub n_workers: usize,
}

/// What the handles share.
#[derive(Debug, Default)]
struct SharedWorkers {
    rules: Mutex<WorkerRules>,
    links: Mutex<Vec<SharedLink>>,
}

impl Drop for SharedWorkers {
    fn drop(&mut self) {
        // All at once, before the first of them is waited for.
        let links = self.links.get_mut().unwrap_or_else(PoisonError::into_inner);
        for link in links.iter() {
            lock(link).let_go();
        }
    }
}

/// A link as several environments share it.
pub(crate) type SharedLink = Arc<Mutex<WorkerLink>>;

/// The workers of a process; a copy is another handle.
#[derive(Clone, Debug, Default)]
pub struct Workers(Arc<SharedWorkers>);

/// An environment of a worker, released when dropped.
#[derive(Debug)]
pub(crate) struct WorkerPlace {
    link: SharedLink,
    index: usize,
}

impl WorkerPlace {
    pub(crate) fn link(&self) -> MutexGuard<'_, WorkerLink> {
        lock(&self.link)
    }

    pub(crate) fn index(&self) -> usize {
        self.index
    }
}

impl Drop for WorkerPlace {
    fn drop(&mut self) {
        lock(&self.link).release(self.index);
    }
}

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Workers {
    /// Says what holds from now on.
    pub fn follow(&self, rules: WorkerRules) {
        *lock(&self.0.rules) = rules;
    }

    /// Allows the commands of configurations, which are this user's own from now on.
    pub fn permit_configured(&self) {
        lock(&self.0.rules).permission = Permission::Configured;
    }

    pub(crate) fn starts_at_once(&self) -> bool {
        lock(&self.0.rules).starts_at_once
    }

    /// Returns how the workers of a configuration are started.
    pub(crate) fn launch(&self, settings: &PythonSettings) -> Result<WorkerLaunch, Error> {
        let rules = lock(&self.0.rules);
        let command = match &rules.permission {
            Permission::Refused => {
                return Err(Error::NotTrusted { command: settings.worker.clone() });
            }
            Permission::Configured => settings.worker.clone(),
            Permission::Own(command) => command.clone(),
        };
        if rules.refuses_pickles && settings.snapshot == SnapshotKind::Pickle {
            return Err(Error::PickleNotTrusted);
        }
        Ok(WorkerLaunch::new(settings, command))
    }

    /// Makes sure that there is a worker.
    pub(crate) fn start(&self, launch: &WorkerLaunch) -> Result<(), Error> {
        let mut links = lock(&self.0.links);
        if let Some(world) = known(&links, launch) {
            return world.map(drop);
        }
        links.push(Arc::new(Mutex::new(start(launch)?)));
        Ok(())
    }

    /// Asks a worker what its environments look like; one that had to be started for it is not kept.
    pub(crate) fn ask(&self, launch: &WorkerLaunch) -> Result<WorldSpec, Error> {
        let known = known(&lock(&self.0.links), launch);
        known.unwrap_or_else(|| Ok(start(launch)?.hello().world.clone()))
    }

    /// Reserves an environment: of the worker that has the fewest, or of a new one.
    pub(crate) fn reserve(&self, launch: &WorkerLaunch) -> Result<WorkerPlace, Error> {
        let mut links = lock(&self.0.links);
        let mut of_kind: Vec<SharedLink> = links.clone();
        of_kind.retain(|link| lock(link).launch().is_like(launch));
        let is_complete = of_kind.len() >= lock(&self.0.rules).n_workers;
        let free = of_kind.into_iter().filter(|link| lock(link).has_room());
        let free = free.min_by_key(|link| lock(link).n_used());
        // Another worker, as long as there are too few, unless one has nothing to do.
        let free = free.filter(|link| is_complete || lock(link).n_used() == 0);
        let link = if let Some(link) = free {
            launch.check(lock(&link).hello())?;
            link
        } else {
            let link = Arc::new(Mutex::new(start(launch)?));
            links.push(Arc::clone(&link));
            link
        };
        let index = lock(&link).reserve();
        // It has room: nothing reserves without the lock on all links.
        let index = index.ok_or_else(|| std::io::Error::other("a worker has no room"))?;
        Ok(WorkerPlace { link, index })
    }

    /// Sends the steps that are announced, to every worker, before any is waited for.
    pub(crate) fn send_steps(&self) {
        let links = lock(&self.0.links);
        links.iter().for_each(|link| lock(link).send_steps());
    }
}

/// Returns the specification of an existing worker's environments.
fn known(links: &[SharedLink], launch: &WorkerLaunch) -> Option<Result<WorldSpec, Error>> {
    links.iter().map(|link| lock(link)).find(|link| link.launch().is_like(launch)).map(|link| {
        launch.check(link.hello())?;
        Ok(link.hello().world.clone())
    })
}

/// Starts a worker, and sees whether pickles of its environments are what they seem.
fn start(launch: &WorkerLaunch) -> Result<WorkerLink, Error> {
    let mut link = WorkerLink::start(launch.clone())?;
    if launch.snapshot == SnapshotKind::Pickle
        && let Some(reason) = check_pickle(&mut link)
    {
        return Err(Error::Start { command: launch.command.clone(), reason });
    }
    Ok(link)
}
