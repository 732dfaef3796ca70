//! What an actor says first, and whether the answer comes from the run it already works for.

use leadtime_proto::header::PROTOCOL_VERSION;
use leadtime_proto::message::{Hello, Welcome};

use crate::ActorSettings;
use crate::outbox::Outbox;

/// Composes a hello: who this is, and what it has made so far.
pub(crate) fn compose_hello(settings: &ActorSettings, outbox: &Outbox) -> Hello {
    Hello {
        protocol: PROTOCOL_VERSION,
        program: settings.program.clone(),
        actor: settings.actor.clone(),
        incarnation: settings.incarnation,
        cpu: settings.cpu.clone(),
        published: outbox.made(),
        first_unacknowledged: outbox.acknowledged().next(),
    }
}

/// Tells whether a welcome is to the run that this actor's threads were set up for.
pub(crate) fn is_same_run(old: &Welcome, new: &Welcome) -> bool {
    (&old.task, &old.env, &old.policy, old.run_seed, old.n_steps, old.schedule)
        == (&new.task, &new.env, &new.policy, new.run_seed, new.n_steps, new.schedule)
}
