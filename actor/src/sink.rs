//! What an actor reports while it works.

use leadtime_trace::TraceSpan;

use crate::ActorProgress;

/// Takes in what an actor reports; called from its loop, so it must be quick.
pub trait ActorSink: Send {
    /// Receives the actor's state, once a second from the first welcome on.
    fn on_tick(&mut self, progress: ActorProgress);

    /// Takes in how a thread of the actor spent its time, for a trace of the run; called a few times per rollout.
    fn on_span(&mut self, span: &TraceSpan<'_>);
}

/// The sink of an actor that nobody watches.
impl ActorSink for () {
    fn on_tick(&mut self, _progress: ActorProgress) {}

    fn on_span(&mut self, _span: &TraceSpan<'_>) {}
}
