//! `leadtime taxonomy speak`: every sentence of a database as sound, with the time of each word.

use std::fs;
use std::path::Path;

use anyhow::Context as _;
use leadtime_proto::phrase::counted;
use leadtime_taxonomy::Topic;
use leadtime_voice::{SoundIndex, SpokenSentence, VoiceBook, recorded, wav};

use super::source;
use crate::cli::TaxonomySpeakArgs;
use crate::exit::{Blame as _, ExitCode, Failure};
use crate::output;

pub(in crate::commands) fn run(args: &TaxonomySpeakArgs) -> Result<(), Failure> {
    let taxonomy = source::database(&args.database)?;
    let utterances = taxonomy.topics().iter().flat_map(Topic::utterances);
    let texts: Vec<&str> = utterances.map(|utterance| utterance.text.as_str()).collect();
    let directory = &args.output;
    // What is there may be somebody's own voice.
    let files = [recorded::WAV, recorded::OGG, recorded::INDEX];
    if let Some(there) = files.iter().find(|it| directory.join(it).exists()) {
        let place = directory.display();
        let told =
            format!("{place} holds {there} already, which is left as it is: choose another -o");
        return Err(Failure::input(told));
    }
    let is_new = !directory.exists();
    let spoken = make(directory).and_then(|()| speak(args, &texts));
    let (made_by, sentences) = spoken.inspect_err(|_told| {
        // What cannot be spoken leaves nothing.
        if is_new {
            drop(fs::remove_dir(directory));
        }
    })?;
    let book = VoiceBook::new(args.voice.to_string(), sentences.iter().cloned());
    let (index, sound) = SoundIndex::join(made_by, book.rate, &sentences);
    for (file, bytes) in [
        (recorded::WAV, wav::write(index.rate, &sound)),
        (recorded::INDEX, index.write().into_bytes()),
    ] {
        output::file(&directory.join(file), &bytes).blame(ExitCode::WrongInput)?;
    }
    let (n, place) = (counted(index.n_sentences(), "sentence"), directory.display());
    let seconds = sound.len() as f64 / f64::from(index.rate);
    let mean = book.mean_word();
    output::line(&format!("{n}, {seconds:.0} s of sound, {mean:.2} s a word, in {place}"));
    Ok(())
}

/// Makes the directory of the sound, and makes sure that both files can be written: a slow voice must not speak in vain.
fn make(directory: &Path) -> Result<(), Failure> {
    fs::create_dir_all(directory)
        .with_context(|| format!("cannot make {}", directory.display()))
        .blame(ExitCode::WrongInput)?;
    [recorded::WAV, recorded::INDEX]
        .iter()
        .try_for_each(|file| output::check_file(&directory.join(file)))
        .blame(ExitCode::WrongInput)
}

/// Lets the voice speak every text; returns what it is, and the sentences.
fn speak(
    args: &TaxonomySpeakArgs,
    texts: &[&str],
) -> Result<(String, Vec<SpokenSentence>), Failure> {
    let (made_by, sentences) =
        leadtime_voice::speak(&args.voice, texts).blame(ExitCode::WrongInput)?;
    let n_silent = sentences.iter().filter(|spoken| spoken.sound.is_none()).count();
    if n_silent > 0 {
        // The warning before has said why.
        let told = format!("{} could not be spoken", counted(n_silent, "sentence"));
        return Err(Failure::input(told));
    }
    Ok((made_by, sentences))
}
