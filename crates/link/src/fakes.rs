//! A learner of another release, as tests need it.

use leadtime_proto::header::Schema;
use leadtime_proto::{DomainName, Header, Incarnation, RunName};
use zenoh::Wait as _;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{Query, Queryable};
use zenoh::session::Session;

use crate::keys::{Key, Keys, Member};
use crate::pubsub::{appear, take_questions};
use crate::{Endpoint, ListenSettings, Result, session};

/// Which start of the learner it is.
const START: Incarnation = Incarnation(1);
/// Where a header of any release has its protocol, and the protocol that this learner speaks.
const PROTOCOL: (usize, u8) = (12, 77);

/// A learner that is there, and speaks another protocol.
#[derive(Debug)]
pub struct ForeignLearner {
    _alive: LivelinessToken,
    _hellos: Queryable<()>,
    /// Last, because fields are dropped in order: everything declared on the session is undeclared before it closes.
    _session: Session,
}

impl ForeignLearner {
    /// Opens a run at an address. Every hello is answered with the sentence `no`, or, without one, in the learner's own protocol, 77.
    ///
    /// # Errors
    ///
    /// As [`LearnerLink::open`](crate::LearnerLink::open), if nobody can listen there.
    pub async fn open(run: &RunName, endpoint: Endpoint, no: Option<&'static str>) -> Result<Self> {
        let domain = DomainName::new("cartpole")?;
        let settings = ListenSettings::new(vec![endpoint]);
        let session = session::listen(&settings, Keys::RolloutsOf(run, &domain)).await?;
        let hellos = take_questions(&session, Key::Hello(run), move |query| answer(&query, no))?;
        let alive = appear(&session, Key::Alive(run, &Member::Learner, START))?;
        Ok(Self { _alive: alive, _hellos: hellos, _session: session })
    }
}

fn answer(query: &Query, no: Option<&'static str>) {
    let answered = if let Some(no) = no {
        query.reply_err(no).wait()
    } else {
        let mut header = Header::plain(Schema::HelloReply, START, &[]).to_bytes();
        let (at, number) = PROTOCOL;
        header[at] = number;
        query.reply(query.key_expr().clone(), Vec::<u8>::new()).attachment(header).wait()
    };
    // Who asked may be gone.
    drop(answered);
}
