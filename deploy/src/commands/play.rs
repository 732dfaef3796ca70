//! `leadtime play`: one episode as a picture or a page; the file's extension says which kind.

use std::io::{ErrorKind, Write as _};
use std::ops::Range;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Error, anyhow, bail, ensure};
use leadtime_eval::draw::Rasterizer;
use leadtime_eval::playthrough::Spoken;
use leadtime_eval::report::player;
use leadtime_proto::phrase::counted;
use leadtime_recording::{picture, transcript};
use leadtime_runs::Tasks;
use leadtime_runs::evaluation::EVAL_SEED;

use super::opponent::opponents;
use super::{episode, evaluation, recorded};
use crate::cli::PlayArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output::{self, DRAW_MORE, TRY};

/// Pixels per unit of a PNG.
const PNG_SCALE: f32 = 2.0;
/// The most moments beside each other.
const MAX_FRAMES: u64 = 60;
/// The moments of the demonstration: all words, and what the cook does with them.
const DEMONSTRATION_FRAMES: Range<u64> = 0..8;
/// The most moments of a GIF and of a page.
const MAX_MOMENTS: usize = 150;
/// How long these play, in seconds.
const SECONDS: f64 = 12.0;

pub(super) fn run(tasks: &Tasks, args: &PlayArgs) -> Result<(), Failure> {
    if let Some(recording) = args.policy.as_deref().filter(|path| extension(path) == "mcap") {
        return draw_recording(recording, args);
    }
    if args.live.is_some() {
        return Err(Failure::input("--live chooses a client of a recording: name a FILE.mcap"));
    }
    let kinds = ["png", "svg", "gif", "html", "mp4"];
    if !kinds.contains(&extension(&args.output).as_str()) {
        let shown = args.output.display();
        let sentence = format!("{shown}: the extension must be png, svg, gif, html or mp4");
        return Err(Failure::input(sentence));
    }
    if args.demonstration {
        let spoken = Spoken::demonstration().blame(ExitCode::Failed)?;
        let frames = args.frames.clone().unwrap_or(DEMONSTRATION_FRAMES);
        write(&spoken, Some(frames), &args.output)?;
        output::next(Path::new(""), &[TRY]);
        return Ok(());
    }
    let name = args.policy.as_deref().unwrap_or(Path::new(""));
    let acting = &args.acting;
    acting.choosing.worker.permit(tasks, name);
    let loaded = evaluation::load(tasks, &acting.choosing.runs, name, &acting.set);
    let loaded = loaded.blame(ExitCode::WrongInput)?;
    let environment = tasks.registry.build(&loaded.config.evaluation.task);
    let environment = environment.blame(ExitCode::WrongInput)?;
    let others = opponents(args.baseline.as_slice(), environment.as_ref());
    let player = match others.blame(ExitCode::WrongInput)?.pop() {
        Some(player) => player,
        None => loaded.player("policy", acting.choosing.action)?,
    };
    let voice = episode::voice(tasks, &loaded.config, args.words.as_deref())?;
    let (voice, seed) = (voice.as_ref(), acting.choosing.eval_seed);
    let spoken = leadtime_runs::evaluation::record(tasks, &loaded.config, &player, voice, seed, 0);
    write(&spoken.blame(ExitCode::WrongInput)?, args.frames.clone(), &args.output)?;
    output::next(&loaded.path, &[DRAW_MORE]);
    Ok(())
}

/// Draws the whole episode, or some of its moments, and says so.
fn write(spoken: &Spoken, frames: Option<Range<u64>>, path: &Path) -> Result<(), Failure> {
    match frames {
        Some(frames) => draw_frames(spoken, &frames, path),
        None => draw(spoken, path),
    }
    .blame(ExitCode::WrongInput)?;
    let (title, n_steps) = (spoken.played.title(), spoken.played.n_steps());
    output::line(&format!("{}: {title}, {n_steps} steps", path.display()));
    Ok(())
}

/// Refuses options that change what a policy does: a recording shows what was.
fn refuse_options_of_policies(args: &PlayArgs) -> Result<(), Failure> {
    let acting = &args.acting;
    let options = [
        ("--words", args.words.is_some()),
        ("--baseline", args.baseline.is_some()),
        ("--set", !acting.set.is_empty()),
        ("--action", acting.choosing.action.is_some()),
        ("--eval-seed", acting.choosing.eval_seed != EVAL_SEED),
    ];
    let given = options.into_iter().find(|(_, is_given)| *is_given);
    given.map_or(Ok(()), |(option, _)| {
        let sentence = format!(
            "{option} changes nothing in a recording, which shows what was said: leave it out"
        );
        Err(Failure::input(sentence))
    })
}

/// Draws the sessions of a recording, or writes what was said in them.
fn draw_recording(recording: &Path, args: &PlayArgs) -> Result<(), Failure> {
    refuse_options_of_policies(args)?;
    let sessions = recorded::read(recording, args.live.as_ref())?;
    let path = &args.output;
    let n = counted(sessions.len(), "session");
    let mut what = n.clone();
    let bytes = match extension(path).as_str() {
        "txt" => {
            let texts = sessions.iter().map(|it| transcript(it, args.frames.as_ref()));
            texts.collect::<Vec<_>>().join("\n").into_bytes()
        }
        kind @ ("png" | "svg") => {
            let draw = |it| Some((it, picture(it, args.frames.clone())?));
            let nothing = "nothing happens in these seconds of the recording";
            let shown = sessions.iter().find_map(draw);
            let (session, svg) = shown.ok_or_else(|| Failure::input(nothing))?;
            let svg = svg.text;
            what = format!("session {} of {}", session.id, session.client);
            if sessions.len() > 1 {
                what = format!("{what}, the first of {n} with something to show,");
            }
            match kind {
                "svg" => svg.into_bytes(),
                _ => Rasterizer::new().png(&svg, PNG_SCALE).blame(ExitCode::Failed)?,
            }
        }
        _ => {
            let shown = path.display();
            let sentence =
                format!("{shown}: of a recording, the extension must be png, svg or txt");
            return Err(Failure::input(sentence));
        }
    };
    output::file(path, &bytes).blame(ExitCode::WrongInput)?;
    output::line(&format!("{}: {what} of {}", path.display(), recording.display()));
    Ok(())
}

/// Draws some moments of an episode into a file.
fn draw_frames(spoken: &Spoken, frames: &Range<u64>, path: &Path) -> anyhow::Result<()> {
    let (first, n) = (frames.start, frames.end - frames.start);
    let last = spoken.played.n_steps() as u64;
    ensure!(first <= last, "--frames begins at {first}; the episode ends at {last}");
    ensure!(n <= MAX_FRAMES, "--frames asks for {n} moments; allowed: 1 to {MAX_FRAMES}");
    let svg = spoken.frames_svg("frames", first as usize..frames.end as usize).text;
    let bytes = match extension(path).as_str() {
        "png" => Rasterizer::new().png(&svg, PNG_SCALE)?,
        "svg" => svg.into_bytes(),
        other => bail!("frames beside each other cannot be a `{other}` file: png or svg"),
    };
    output::file(path, &bytes)
}

/// Draws an episode into a file.
pub(super) fn draw(spoken: &Spoken, path: &Path) -> anyhow::Result<()> {
    let bytes = match extension(path).as_str() {
        "png" => spoken.png(&Rasterizer::new(), PNG_SCALE)?,
        "svg" => spoken.svg("playthrough").text.into_bytes(),
        "gif" => spoken.gif(&Rasterizer::new(), MAX_MOMENTS, SECONDS)?,
        "html" => player(spoken, MAX_MOMENTS, SECONDS).into_bytes(),
        "mp4" => {
            return film(&spoken.gif(&Rasterizer::new(), MAX_MOMENTS, SECONDS)?, path);
        }
        other => bail!("a picture cannot be a `{other}` file"),
    };
    output::file(path, &bytes)
}

/// Lets ffmpeg make a film of an animated GIF.
fn film(gif: &[u8], path: &Path) -> anyhow::Result<()> {
    // Both sides must be even there.
    let even = "scale=trunc(iw/2)*2:trunc(ih/2)*2";
    let mut ffmpeg = Command::new("ffmpeg")
        .args(["-loglevel", "error", "-y", "-f", "gif", "-i", "pipe:0", "-vf", even])
        .args(["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"])
        .arg(path)
        .stdin(Stdio::piped())
        .spawn()
        .map_err(|error| match error.kind() {
            ErrorKind::NotFound => anyhow!("an mp4 needs ffmpeg: install it, or draw a gif"),
            _ => Error::new(error).context("an mp4 needs ffmpeg, which cannot be started"),
        })?;
    let given = ffmpeg.stdin.take().map_or(Ok(()), |mut input| input.write_all(gif));
    let ended = ffmpeg.wait()?;
    ensure!(ended.success(), "ffmpeg could not write {}: see above", path.display());
    given.context("handing the pictures to ffmpeg")
}

/// Returns the extension of a path in lower case.
fn extension(path: &Path) -> String {
    path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase()
}
