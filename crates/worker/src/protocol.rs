//! What travels between this process and a worker: frames `u32 length, u8 kind, body`, little-endian, version 1.
//!
//! | kind | from | body |
//! |---|---|---|
//! | 1 hello | worker | magic `LDWK`, version u16, environments u16 at most, D u32, H u8, choices u8 each, flags u8 (0), JSON: heads, metrics, versions |
//! | 2 begin | us | n u16; each: slot u16, seed u32, snapshot: length u32 and bytes |
//! | 3 step | us | n u16; each: slot u16, seed of the next episode u32, H choices u8 |
//! | 4 stepped | worker | n u16; observations n x D f32, rewards n f32, ends n u8, masks n u64; then for each that ended: last observation D f32, metrics M f32 |
//! | 5 snapshot | us | slot u16 |
//! | 6 snapshotted | worker | the pickle, at most 196,608 bytes; nothing where a *failed* frame came before |
//! | 7 log | worker | level u8 (0 debug, 1 info, 2 warning, 3 error), text |
//! | 8 failed | worker | slot u16 (or 65535: the worker itself), text of the exception |
//! | 9 alive | worker | nothing: the environments take their time, one by one |
//!
//! *Begin* and *step* are answered by *stepped*, in the order of the slots. An end is 0 (none), 1 (terminated), 2 (truncated), or
//! 3 (failed; a *failed* frame came before). Where an episode has ended, the worker has begun the next one with the seed that
//! came with the step: the observation in its row is the first of that episode, the mask too. A snapshot in *begin* is the length
//! u32 of a pickle, the pickle (0: the episode begins with the seed), and the actions since, H bytes each, to be taken again.
//!
//! Nothing that a worker sends is believed: lengths are bounded before anything is allocated, and numbers are checked.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::time::{Duration, Instant};

use leadtime_proto::Head;
use leadtime_proto::text::printable;
use leadtime_sims::End;
use serde::Deserialize;
use thiserror::Error;

use crate::settings::{MAX_OBS_DIM, WorldSpec};

/// The version of the protocol, which a hello states.
pub const VERSION: u16 = 1;
/// How a hello begins.
const MAGIC: [u8; 4] = *b"LDWK";
/// The largest hello, in bytes.
pub const MAX_HELLO_BYTES: usize = 64 << 10;
/// The longest text of a log line or of an exception.
pub const MAX_TEXT_BYTES: usize = 8 << 10;
/// Frames besides the answer that are read before it: log lines, failures, signs of life.
pub const MAX_ASIDE: usize = 100_000;
/// How much is read at a time, so that a length alone allocates nothing.
const CHUNK: usize = 64 << 10;
/// The slot that stands for the worker itself.
const WORKER_ITSELF: u16 = u16::MAX;

/// The kinds of frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[expect(missing_docs, reason = "the table above says what each is")]
pub enum FrameKind {
    Hello = 1,
    Begin = 2,
    Step = 3,
    Stepped = 4,
    Snapshot = 5,
    Snapshotted = 6,
    Log = 7,
    Failed = 8,
    Alive = 9,
}

impl FrameKind {
    /// Names a kind that answers, as sentences do.
    fn described(self) -> &'static str {
        match self {
            Self::Hello => "a hello",
            Self::Stepped => "the outcome of a step",
            Self::Snapshotted => "a pickle",
            _ => "no answer",
        }
    }
}

/// What is wrong with what a worker sends, or with the way to it.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the sentence of each variant names its fields")]
pub enum ProtocolError {
    /// The other end is closed.
    #[error("it closed the connection")]
    Closed,
    /// Nothing came for too long.
    #[error(
        "it said nothing for {}; where a step or a reset takes longer, raise world.step_timeout",
        leadtime_proto::phrase::duration(*timeout)
    )]
    Silent { timeout: Duration },
    /// The socket cannot be read or written.
    #[error("the connection broke: {0}")]
    Io(io::Error),
    /// A frame of an unknown kind, or of one that is not expected now.
    #[error("it sent a frame of kind {found} where {expected} was expected")]
    Kind { found: u8, expected: &'static str },
    /// A frame of an impossible length.
    #[error("it sent a frame of {found} bytes where at most {most} are possible")]
    TooLong { found: usize, most: usize },
    /// A frame whose contents do not fit.
    #[error("it sent a frame that cannot be read: {0}")]
    Malformed(String),
    /// It reported that it cannot go on.
    #[error("{0}")]
    GaveUp(String),
}

// The sentence already contains its cause, so `source()` does not repeat it.
impl From<io::Error> for ProtocolError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// Reads from a body, piece by piece.
struct FrameBody<'a>(&'a [u8]);

impl<'a> FrameBody<'a> {
    fn take(&mut self, n: usize, what: &str) -> Result<&'a [u8], ProtocolError> {
        let short = || ProtocolError::Malformed(format!("it ends before {what}"));
        let (taken, rest) = self.0.split_at_checked(n).ok_or_else(short)?;
        self.0 = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], ProtocolError> {
        let bytes = self.take(N, what)?;
        Ok(bytes.try_into().unwrap_or([0; N]))
    }

    fn u8(&mut self, what: &str) -> Result<u8, ProtocolError> {
        self.array::<1>(what).map(|[byte]| byte)
    }

    fn u16(&mut self, what: &str) -> Result<u16, ProtocolError> {
        self.array(what).map(u16::from_le_bytes)
    }

    fn end(&self) -> Result<(), ProtocolError> {
        let n = self.0.len();
        let spare = || ProtocolError::Malformed(format!("{n} bytes too many"));
        if n == 0 { Ok(()) } else { Err(spare()) }
    }
}

/// What a worker says of itself and of its environments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WorkerHello {
    /// The most environments that it steps.
    pub max_envs: usize,
    /// What the environments look like.
    pub world: WorldSpec,
    /// The metrics that it sends at the end of an episode.
    pub metrics: Vec<String>,
}

/// The JSON at the end of a hello.
#[derive(Deserialize)]
struct HelloNames {
    heads: Vec<String>,
    metrics: Vec<String>,
    versions: BTreeMap<String, String>,
}

/// Reads a hello's body.
///
/// # Errors
///
/// [`ProtocolError::Malformed`] if the bytes are no hello, or one of another version.
pub fn read_hello(body: &[u8]) -> Result<WorkerHello, ProtocolError> {
    let mut body = FrameBody(body);
    let malformed = |text: String| ProtocolError::Malformed(text);
    if body.array::<4>("the magic")? != MAGIC {
        return Err(malformed("it does not begin as a worker's hello does".to_owned()));
    }
    let version = body.u16("the version")?;
    if version != VERSION {
        return Err(malformed(format!("protocol version {version}, this program has {VERSION}")));
    }
    let max_envs = usize::from(body.u16("the number of environments")?);
    let obs_dim = u32::from_le_bytes(body.array("the observation's length")?) as usize;
    if !(1..=MAX_OBS_DIM).contains(&obs_dim) || max_envs == 0 {
        let range = format!("1 to {MAX_OBS_DIM} are possible");
        return Err(malformed(format!(
            "{max_envs} environments with observations of {obs_dim} numbers; {range}"
        )));
    }
    let n_heads = usize::from(body.u8("the number of heads")?);
    let choices = body.take(n_heads, "the heads")?;
    body.u8("the flags")?;
    let names: HelloNames =
        serde_json::from_slice(body.0).map_err(|error| malformed(printable(&error.to_string())))?;
    if names.heads.len() != n_heads {
        return Err(malformed(format!("{} names for {n_heads} heads", names.heads.len())));
    }
    let head = |(name, n_choices): (String, &u8)| Head {
        name: printable(&name),
        n_choices: usize::from(*n_choices),
    };
    let heads = names.heads.into_iter().zip(choices).map(head).collect();
    let world = WorldSpec { obs_dim, heads, versions: names.versions };
    Ok(WorkerHello { max_envs, world, metrics: names.metrics })
}

/// The lengths that decide how frames are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameShape {
    /// D, the length of an observation.
    pub obs_dim: usize,
    /// H, the number of heads.
    pub n_heads: usize,
    /// M, the number of metrics.
    pub n_metrics: usize,
}

impl FrameShape {
    /// Returns the size of the largest answer about so many environments.
    pub fn max_stepped_bytes(&self, n: usize) -> usize {
        2 + n * (2 * 4 * self.obs_dim + 4 + 1 + 8 + 4 * self.n_metrics)
    }
}

/// What a step, or the beginning of an episode, has shown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepRow {
    /// What is acted on next. Shape `[D]`.
    pub observation: Vec<f32>,
    /// The reward of the step.
    pub reward: f32,
    /// The end of the episode.
    pub end: Option<End>,
    /// The step was not taken, because the environment failed.
    pub has_failed: bool,
    /// The choices that are offered next.
    pub mask: u64,
    /// Where the episode has ended, its last observation. Shape `[D]`.
    pub last_observation: Vec<f32>,
    /// Where the episode has ended, its metrics. Shape `[M]`.
    pub metrics: Vec<f32>,
}

/// Reads the body of an answer about as many environments as there are rows.
///
/// # Errors
///
/// [`ProtocolError::Malformed`] if it is not of this shape. Some rows may have been written then.
pub fn read_stepped(
    body: &[u8],
    shape: FrameShape,
    rows: &mut [StepRow],
) -> Result<(), ProtocolError> {
    let (mut body, n) = (FrameBody(body), rows.len());
    let told = usize::from(body.u16("the number of environments")?);
    if told != n {
        let text = format!("it is about {told} environments, not {n}");
        return Err(ProtocolError::Malformed(text));
    }
    let observations = body.take(n * 4 * shape.obs_dim, "the observations")?;
    let rewards = body.take(4 * n, "the rewards")?;
    let ends = body.take(n, "the ends")?;
    let masks = body.take(8 * n, "the masks")?;
    for (i, row) in rows.iter_mut().enumerate() {
        let of_row = &observations[i * 4 * shape.obs_dim..][..4 * shape.obs_dim];
        floats(of_row, &mut row.observation);
        row.reward = float(&rewards[4 * i..]);
        row.mask =
            masks[8 * i..][..8].iter().rev().fold(0, |word, byte| word << 8 | u64::from(*byte));
        (row.end, row.has_failed) = match ends[i] {
            0 => (None, false),
            1 => (Some(End::Terminated), false),
            2 => (Some(End::Truncated), false),
            3 => (None, true),
            other => return Err(ProtocolError::Malformed(format!("an end of kind {other}"))),
        };
        if row.end.is_some() {
            floats(body.take(4 * shape.obs_dim, "a last observation")?, &mut row.last_observation);
            floats(body.take(4 * shape.n_metrics, "metrics")?, &mut row.metrics);
        }
    }
    body.end()
}

fn float(bytes: &[u8]) -> f32 {
    bytes.first_chunk().map_or(f32::NAN, |bytes| f32::from_le_bytes(*bytes))
}

fn floats(bytes: &[u8], out: &mut Vec<f32>) {
    out.clear();
    out.extend(bytes.chunks_exact(4).map(float));
}

/// Something that a worker says besides an answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Aside {
    /// A line for the log.
    Log {
        /// 0 debug, 1 info, 2 warning, 3 error.
        level: u8,
        /// What it says, one line.
        text: String,
    },
    /// An environment has failed.
    Failed {
        /// The environment's place in the worker.
        slot: u16,
        /// The exception, with where it was raised.
        text: String,
    },
}

/// Composes frames: [`FrameWriter::begin`], what belongs in it, [`FrameWriter::finish`].
#[derive(Debug, Default)]
pub struct FrameWriter(Vec<u8>);

impl FrameWriter {
    /// Begins a frame of a kind; what was written before is dropped.
    pub fn begin(&mut self, kind: FrameKind) {
        self.0.clear();
        self.0.extend_from_slice(&[0, 0, 0, 0, kind as u8]);
    }

    /// Appends a number of slots, or the number of one.
    pub fn slot(&mut self, n: usize) {
        self.0.extend_from_slice(&(n as u16).to_le_bytes());
    }

    /// Appends a number as four bytes, little-endian.
    pub fn number(&mut self, n: u32) {
        self.0.extend_from_slice(&n.to_le_bytes());
    }

    /// Appends bytes as they are, without their length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    /// Ends the frame and returns it.
    pub fn finish(&mut self) -> &[u8] {
        let n_bytes = (self.0.len().saturating_sub(5)) as u32;
        if let Some(length) = self.0.first_chunk_mut() {
            *length = n_bytes.to_le_bytes();
        }
        &self.0
    }
}

/// Reads a worker's frames, with a limit on the length of each and on how long it is waited for.
#[derive(Debug)]
pub struct FrameReader<R> {
    source: R,
    /// What was read beyond the last frame.
    buffer: Vec<u8>,
    /// Where in it the next frame begins.
    at: usize,
}

impl<R: Read> FrameReader<R> {
    /// Reads from a source whose reads return now and then, so that the time can be looked at: with
    /// [`io::ErrorKind::WouldBlock`] or [`io::ErrorKind::TimedOut`].
    pub fn new(source: R) -> Self {
        Self { source, buffer: Vec::new(), at: 0 }
    }

    /// Reads frames up to the answer, which is of `kind` and has at most `most` bytes, and returns its body; hands
    /// everything else to `aside`.
    ///
    /// A frame may take `timeout` from the one before, and all of them `patience`.
    ///
    /// # Errors
    ///
    /// [`ProtocolError`] if something else comes, nothing comes in time, or the connection is closed. The connection is
    /// of no use then.
    pub fn answer(
        &mut self,
        kind: FrameKind,
        most: usize,
        timeout: Duration,
        patience: Duration,
        mut aside: impl FnMut(Aside),
    ) -> Result<&[u8], ProtocolError> {
        let last = Instant::now() + patience;
        for _ in 0..MAX_ASIDE {
            let deadline = (Instant::now() + timeout).min(last);
            self.fill(5, deadline, timeout)?;
            let header = &self.buffer[self.at..][..5];
            let n_bytes = u32::from_le_bytes([header[0], header[1], header[2], header[3]]) as usize;
            let found = header[4];
            let is_answer = found == kind as u8;
            let most = match found {
                _ if is_answer => most,
                found if found == FrameKind::Alive as u8 => 0,
                found if found == FrameKind::Log as u8 => 1 + MAX_TEXT_BYTES,
                found if found == FrameKind::Failed as u8 => 2 + MAX_TEXT_BYTES,
                found => return Err(ProtocolError::Kind { found, expected: kind.described() }),
            };
            if n_bytes > most {
                return Err(ProtocolError::TooLong { found: n_bytes, most });
            }
            self.fill(5 + n_bytes, deadline, timeout)?;
            let from = self.at + 5;
            self.at = from + n_bytes;
            if is_answer {
                return Ok(&self.buffer[from..][..n_bytes]);
            }
            let mut body = FrameBody(&self.buffer[from..][..n_bytes]);
            if found == FrameKind::Log as u8 {
                let level = body.u8("the level")?;
                aside(Aside::Log { level, text: text(body.0) });
            } else if found == FrameKind::Failed as u8 {
                let slot = body.u16("the slot")?;
                let text = text(body.0);
                if slot == WORKER_ITSELF {
                    return Err(ProtocolError::GaveUp(text));
                }
                aside(Aside::Failed { slot, text });
            }
        }
        Err(ProtocolError::Malformed(format!("{MAX_ASIDE} frames and no answer")))
    }

    /// Reads until the next `n` bytes are there.
    fn fill(
        &mut self,
        n: usize,
        deadline: Instant,
        timeout: Duration,
    ) -> Result<(), ProtocolError> {
        if self.at > 0 && self.buffer.len() - self.at < n {
            self.buffer.drain(..self.at);
            self.at = 0;
        }
        while self.buffer.len() - self.at < n {
            let filled = self.buffer.len();
            self.buffer.resize(filled + CHUNK, 0);
            let read = self.source.read(&mut self.buffer[filled..]);
            let n_read = read.as_ref().map_or(0, |n_read| *n_read);
            self.buffer.truncate(filled + n_read);
            match read {
                Ok(0) => return Err(ProtocolError::Closed),
                Ok(_) => {}
                Err(error) => match error.kind() {
                    io::ErrorKind::WouldBlock
                    | io::ErrorKind::TimedOut
                    | io::ErrorKind::Interrupted => {
                        if Instant::now() >= deadline {
                            return Err(ProtocolError::Silent { timeout });
                        }
                    }
                    io::ErrorKind::ConnectionReset => return Err(ProtocolError::Closed),
                    _ => return Err(error.into()),
                },
            }
        }
        Ok(())
    }
}

fn text(bytes: &[u8]) -> String {
    printable(&String::from_utf8_lossy(bytes))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SHAPE: FrameShape = FrameShape { obs_dim: 2, n_heads: 1, n_metrics: 1 };
    const SOON: Duration = Duration::from_secs(5);

    fn frame(kind: u8, body: &[u8]) -> Vec<u8> {
        let mut frame = (body.len() as u32).to_le_bytes().to_vec();
        frame.push(kind);
        frame.extend_from_slice(body);
        frame
    }

    fn hello(json: &str) -> Vec<u8> {
        let mut body = b"LDWK\x01\x00\x10\x00\x02\x00\x00\x00\x01\x03\x00".to_vec();
        body.extend_from_slice(json.as_bytes());
        body
    }

    /// Two environments, of which the second has ended.
    fn stepped() -> Vec<u8> {
        let mut body = 2_u16.to_le_bytes().to_vec();
        for x in [1.0_f32, 2.0, 3.0, 4.0, 0.5, 1.5] {
            body.extend_from_slice(&x.to_le_bytes());
        }
        body.extend_from_slice(&[0, 2]);
        for mask in [u64::MAX, 5] {
            body.extend_from_slice(&mask.to_le_bytes());
        }
        for x in [7.0_f32, 8.0, 1.0] {
            body.extend_from_slice(&x.to_le_bytes());
        }
        body
    }

    fn answer(bytes: &[u8], most: usize) -> Result<Vec<u8>, ProtocolError> {
        let mut reader = FrameReader::new(bytes);
        reader.answer(FrameKind::Stepped, most, SOON, SOON, |_aside| {}).map(<[u8]>::to_vec)
    }

    fn rows(body: &[u8]) -> Result<Vec<StepRow>, ProtocolError> {
        let mut rows = [StepRow::default(), StepRow::default()];
        read_stepped(body, SHAPE, &mut rows)?;
        Ok(rows.to_vec())
    }

    #[test]
    fn an_answer_is_read_to_the_last_byte() {
        let rows = rows(&stepped()).unwrap();
        assert_eq!(
            (&*rows[0].observation, rows[0].reward, rows[0].end),
            (&[1.0, 2.0][..], 0.5, None)
        );
        assert_eq!((rows[0].mask, rows[1].mask), (u64::MAX, 5));
        assert_eq!(rows[1].end, Some(End::Truncated));
        assert_eq!((&*rows[1].last_observation, &*rows[1].metrics), (&[7.0, 8.0][..], &[1.0][..]));
        assert_eq!(stepped().len(), 2 + 16 + 8 + 2 + 16 + 12);
        assert!(stepped().len() <= SHAPE.max_stepped_bytes(2));
    }

    #[test]
    fn asides_come_before_the_answer_and_a_worker_that_gives_up_is_quoted() {
        let mut bytes = frame(9, b"");
        bytes.extend(frame(7, b"\x02careful"));
        bytes.extend(frame(8, b"\x01\x00ValueError: no (env.py:3)"));
        bytes.extend(frame(4, &stepped()));
        let mut asides = Vec::new();
        let mut reader = FrameReader::new(&*bytes);
        let kind = FrameKind::Stepped;
        let body = reader.answer(kind, 1_000, SOON, SOON, |aside| asides.push(aside)).unwrap();
        assert_eq!(body, stepped());
        let failed = Aside::Failed { slot: 1, text: "ValueError: no (env.py:3)".to_owned() };
        assert_eq!(asides, [Aside::Log { level: 2, text: "careful".to_owned() }, failed]);
        let gave_up = answer(&frame(8, b"\xff\xffImportError: no module"), 1_000).unwrap_err();
        assert_eq!(gave_up.to_string(), "ImportError: no module");
    }

    #[test]
    fn lengths_are_refused_before_anything_is_allocated() {
        let mut huge = 0x8000_0000_u32.to_le_bytes().to_vec();
        huge.push(4);
        let mut reader = FrameReader::new(&*huge);
        let kind = FrameKind::Stepped;
        let refused = reader.answer(kind, 1_000, SOON, SOON, |_| {}).unwrap_err().to_string();
        assert_eq!(refused, "it sent a frame of 2147483648 bytes where at most 1000 are possible");
        assert!(reader.buffer.capacity() <= 2 * CHUNK);
        let refused = answer(&frame(77, b""), 10).unwrap_err().to_string();
        assert_eq!(refused, "it sent a frame of kind 77 where the outcome of a step was expected");
        assert!(matches!(answer(b"\x01\x00", 10), Err(ProtocolError::Closed)));
    }

    #[test]
    fn a_hello_says_what_the_environments_look_like() {
        let json = r#"{"heads": ["move"], "metrics": ["success"], "versions": {"python": "3.11"}}"#;
        let said = read_hello(&hello(json)).unwrap();
        assert_eq!((said.max_envs, said.world.obs_dim), (16, 2));
        assert_eq!(said.world.heads, [Head { name: "move".to_owned(), n_choices: 3 }]);
        assert_eq!(said.metrics, ["success"]);
        for (body, told) in [
            (&b"GARBAGE"[..], "does not begin as a worker's hello"),
            (b"LDWK\x02\x00", "protocol version 2, this program has 1"),
            (&hello("{}"), "missing field"),
            (&hello(r#"{"heads": [], "metrics": [], "versions": {}}"#), "0 names for 1 heads"),
        ] {
            let refused = read_hello(body).unwrap_err().to_string();
            assert!(refused.contains(told), "{refused}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_bring_the_reader_down(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            drop(read_hello(&bytes));
            drop(rows(&bytes));
            drop(answer(&bytes, 200));
            drop(answer(&frame(4, &bytes), 200));
        }

        #[test]
        fn a_changed_answer_is_refused_or_has_its_shape(at in 0_usize..60, byte in any::<u8>()) {
            let mut body = stepped();
            let n = body.len();
            body[at % n] = byte;
            if let Ok(rows) = rows(&body) {
                prop_assert!(rows.iter().all(|row| row.observation.len() == 2));
            }
        }
    }
}
