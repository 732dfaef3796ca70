//! A loudspeaker: a program that plays what it gets, block by block, at the pace of time.
//!
//! ```text
//! play, hush --orders-->  thread: Playback  --20 ms every 20 ms-->  aplay -t raw
//! ```
//!
//! Silence is written too, so the loudspeaker is ready, and one that is gone is noticed while nothing is said. Its clock
//! is not ours: in silence a block is left out whenever one still waits in the pipe. A loudspeaker that ends, or that takes nothing
//! for half a second while it is to sound, or for five seconds in silence, is *mute*; it is tried again every five seconds, and is
//! back once it takes something.

use std::io::{self, Write as _};
use std::process::{ChildStdin, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use process_wrap::std::ChildWrapper;
use tracing::{info, warn};

use crate::child;
use crate::error::VoiceError;
use crate::playback::{BLOCK, LEAD, Playback};
use crate::sentence::SpokenSentence;

/// The program that plays unless another one is named.
pub const APLAY: &str = "aplay";
/// What stands for the rate in a command.
const RATE: &str = "{rate}";
/// The most orders that wait.
const MAX_ORDERS: usize = 64;
/// How much sound may wait in the pipe, in milliseconds: one that takes less is not playing.
const MAX_WAITING: u64 = 500;
/// The most bytes that may wait in its pipe: well below what a pipe holds (64 KiB), or writing would wait for a player that hangs.
const MAX_WAITING_BYTES: u64 = 32 << 10;
/// For how many blocks in a row a loudspeaker may take nothing in silence: five seconds, because it may open its device first.
const MAX_UNTAKEN: u32 = 5_000 / BLOCK;
/// When a loudspeaker that was gone is tried again, and from when on it counts as back.
const TRY_AGAIN: Duration = Duration::from_secs(5);
const IS_BACK: Duration = Duration::from_secs(1);
/// How long a command may take to say that it is not there.
const NOT_FOUND_WITHIN: Duration = Duration::from_millis(200);

/// Orders to the thread.
#[derive(Debug)]
enum SoundOrder {
    Play(Arc<SpokenSentence>),
    Hush,
}

/// A running loudspeaker; the last one that holds it ends it.
#[derive(Clone, Debug)]
pub struct Loudspeaker(Arc<LoudspeakerThread>);

#[derive(Debug)]
struct LoudspeakerThread {
    orders: Option<SyncSender<SoundOrder>>,
    is_mute: Arc<AtomicBool>,
    handle: Option<JoinHandle<()>>,
}

impl Loudspeaker {
    /// Starts a command of the shell that plays 16-bit samples, little-endian, one channel, at `rate` a second, or `aplay`.
    ///
    /// `{rate}` in the command is replaced by the rate.
    ///
    /// # Errors
    ///
    /// [`VoiceError::Missing`] if there is no such command, [`VoiceError::Start`] if nothing can be started at all.
    pub fn start(command: Option<&str>, rate: u32) -> Result<Self, VoiceError> {
        let program = SoundCommand { command: command.map(str::to_owned), rate };
        let playing = Playing::new(program.start()?, program);
        let is_mute = Arc::clone(&playing.is_mute);
        let (orders, waiting) = sync_channel(MAX_ORDERS);
        let failed = |source| VoiceError::Start { what: "a thread for sound".to_owned(), source };
        let thread = thread::Builder::new().name("loudspeaker".to_owned());
        let handle = thread.spawn(move || playing.run(&waiting)).map_err(failed)?;
        let (orders, handle) = (Some(orders), Some(handle));
        Ok(Self(Arc::new(LoudspeakerThread { orders, is_mute, handle })))
    }

    /// Plays a sentence; what is being played is cut. Never waits.
    pub fn play(&self, sentence: &Arc<SpokenSentence>) {
        self.order(SoundOrder::Play(Arc::clone(sentence)));
    }

    /// Falls silent within 80 ms. Never waits.
    pub fn hush(&self) {
        self.order(SoundOrder::Hush);
    }

    /// Returns whether it is gone.
    pub fn is_mute(&self) -> bool {
        self.0.is_mute.load(Ordering::Relaxed)
    }

    fn order(&self, order: SoundOrder) {
        // A full queue means that the thread hangs; its loudspeaker will be reported as mute.
        if let Some(orders) = &self.0.orders {
            drop(orders.try_send(order));
        }
    }
}

impl Drop for LoudspeakerThread {
    fn drop(&mut self) {
        drop(self.orders.take());
        if let Some(handle) = self.handle.take() {
            drop(handle.join());
        }
    }
}

/// The program that plays: the given one, or [`APLAY`].
#[derive(Clone, Debug)]
struct SoundCommand {
    command: Option<String>,
    rate: u32,
}

/// A program that plays, with its standard input.
#[derive(Debug)]
struct SoundPlayer {
    child: Box<dyn ChildWrapper>,
    input: ChildStdin,
    /// How many bytes would wait if it had taken nothing since the last look.
    left: u64,
    /// It has taken something.
    has_taken: bool,
    /// For how many blocks in a row it has taken nothing.
    n_untaken: u32,
}

impl SoundCommand {
    fn name(&self) -> String {
        self.command.clone().unwrap_or_else(|| APLAY.to_owned())
    }

    fn command(&self) -> Command {
        let rate = self.rate.to_string();
        let Some(command) = &self.command else {
            let mut aplay = Command::new(APLAY);
            let buffer = (u64::from(LEAD) * 1_000).to_string();
            aplay.args(["-q", "-t", "raw", "-f", "S16_LE", "-c", "1", "-r", &rate]);
            aplay.args(["--buffer-time", &buffer]);
            return aplay;
        };
        child::shell(&command.replace(RATE, &rate))
    }

    fn missing(&self) -> VoiceError {
        match &self.command {
            None => VoiceError::Missing {
                program: APLAY.to_owned(),
                package: "alsa-utils",
                instead: "--play=COMMAND",
            },
            Some(command) => VoiceError::Missing {
                program: command.clone(),
                package: "it",
                instead: "--play without a command, which is aplay",
            },
        }
    }

    fn spawn(&self) -> io::Result<SoundPlayer> {
        let mut command = self.command();
        command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut child = child::spawn(command)?;
        let input = child.stdin().take().ok_or(io::ErrorKind::BrokenPipe)?;
        Ok(SoundPlayer { child, input, left: 0, has_taken: false, n_untaken: 0 })
    }

    /// Starts it, and waits a moment whether it is there at all.
    fn start(&self) -> Result<SoundPlayer, VoiceError> {
        let mut player = self.spawn().map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => self.missing(),
            _ => VoiceError::Start { what: self.name(), source },
        })?;
        match child::status_within(player.child.as_mut(), NOT_FOUND_WITHIN) {
            Some(status) if status.code() == Some(child::NOT_FOUND) => Err(self.missing()),
            _ => Ok(player),
        }
    }
}

impl SoundPlayer {
    /// Returns how many bytes it has not taken yet, and notes whether it has taken something.
    fn look(&mut self) -> u64 {
        let waiting = rustix::io::ioctl_fionread(&self.input).unwrap_or(0);
        if waiting < self.left {
            (self.has_taken, self.n_untaken) = (true, 0);
        } else if waiting > 0 {
            self.n_untaken = self.n_untaken.saturating_add(1);
        }
        self.left = waiting;
        waiting
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.left += bytes.len() as u64;
        self.input.write_all(bytes)
    }
}

impl Drop for SoundPlayer {
    fn drop(&mut self) {
        child::end(self.child.as_mut());
    }
}

/// What the thread of a loudspeaker works with.
struct Playing {
    name: String,
    program: SoundCommand,
    playback: Playback,
    player: Option<SoundPlayer>,
    /// When the player was started, or was found to be gone.
    started: Instant,
    /// When the next block is due.
    due: Instant,
    is_mute: Arc<AtomicBool>,
}

impl Playing {
    fn new(player: SoundPlayer, program: SoundCommand) -> Self {
        let now = Instant::now();
        Self {
            name: program.name(),
            playback: Playback::new(program.rate),
            program,
            player: Some(player),
            started: now,
            due: now,
            is_mute: Arc::new(AtomicBool::new(false)),
        }
    }

    fn run(mut self, orders: &Receiver<SoundOrder>) {
        // The loudspeaker's buffer is filled once, and stays filled.
        for _ in 0..LEAD / BLOCK {
            self.write_block();
        }
        self.due = Instant::now() + Duration::from_millis(u64::from(BLOCK));
        loop {
            let wait = self.due.saturating_duration_since(Instant::now());
            match orders.recv_timeout(wait) {
                Ok(SoundOrder::Play(sentence)) => self.playback.play(sentence),
                Ok(SoundOrder::Hush) => self.playback.cut(),
                Err(RecvTimeoutError::Timeout) => self.go_on(),
                Err(RecvTimeoutError::Disconnected) => return self.end(),
            }
        }
    }

    fn go_on(&mut self) {
        let block = Duration::from_millis(u64::from(BLOCK));
        self.write_block();
        self.due += block;
        // What was slept through is not made up for: it would come too late, all at once.
        let now = Instant::now();
        if self.due + block < now {
            self.due = now;
        }
    }

    fn write_block(&mut self) {
        let mut block = vec![0; self.playback.block_len()];
        let was_silent = self.playback.is_silent();
        self.playback.fill(&mut block);
        let Some(player) = &mut self.player else { return self.try_again() };
        let bytes: Vec<u8> = block.iter().flat_map(|sample| sample.to_le_bytes()).collect();
        let (waiting, n) = (player.look(), bytes.len() as u64);
        let is_left_out = was_silent && waiting >= n;
        let is_full = waiting > (n * MAX_WAITING / u64::from(BLOCK)).min(MAX_WAITING_BYTES);
        let why = if player.n_untaken > MAX_UNTAKEN || is_full && !is_left_out {
            "it takes nothing any more".to_owned()
        } else if is_left_out {
            return self.look_whether_it_is_back();
        } else if let Err(error) = player.write(&bytes) {
            error.to_string()
        } else {
            return self.look_whether_it_is_back();
        };
        self.player = None;
        self.started = Instant::now();
        if !self.is_mute.swap(true, Ordering::Relaxed) {
            warn!("the loudspeaker `{}` is gone: {why}; what is said goes on in text", self.name);
        }
    }

    fn try_again(&mut self) {
        if self.started.elapsed() >= TRY_AGAIN {
            self.started = Instant::now();
            self.player = self.program.spawn().ok();
        }
    }

    /// One that was started and takes nothing is not back: nothing would be heard.
    fn look_whether_it_is_back(&mut self) {
        let has_taken = self.player.as_ref().is_some_and(|player| player.has_taken);
        if has_taken && self.is_mute.load(Ordering::Relaxed) && self.started.elapsed() >= IS_BACK {
            self.is_mute.store(false, Ordering::Relaxed);
            info!("the loudspeaker `{}` is back", self.name);
        }
    }

    /// Says the word to its end, or fades, and leaves.
    fn end(mut self) {
        self.playback.cut();
        while !self.playback.is_silent() && self.player.is_some() {
            self.write_block();
        }
        // What is in its buffer is still heard.
        thread::sleep(Duration::from_millis(u64::from(LEAD + BLOCK)));
    }
}

#[cfg(test)]
#[path = "loudspeaker_tests.rs"]
mod tests;
