//! A text changed as another one says, with its comments kept: how a configuration is printed as one complete file.

use crate::layers::BASE;

/// A key or a section's header (then `key` is empty), with what stands above it.
#[derive(Clone, Debug, Default)]
struct Block {
    section: String,
    key: String,
    comment: String,
    lines: String,
}

/// Returns `below` with the values of `above`, which also gives the comment at the head.
///
/// A value that is replaced keeps its comment, and the new value's comes behind it. A key that only `above` has is added to
/// its section, and a section behind the one that it follows in `above`.
pub(crate) fn edited(below: &str, above: &str) -> String {
    let ((_, mut text), (head, above)) = (blocks(below), blocks(above));
    let mut before = String::new();
    for block in above.into_iter().filter(|block| block.key != BASE) {
        let is_same =
            |other: &&mut Block| (&other.section, &other.key) == (&block.section, &block.key);
        let section = block.section.clone();
        if let Some(replaced) = text.iter_mut().find(is_same) {
            replaced.replace_with(block);
        } else {
            let last = |name: &str| text.iter().rposition(|other| other.section == name);
            let known = last(&section).or_else(|| last(&before).filter(|_| !before.is_empty()));
            let end = if section.is_empty() { 0 } else { text.len() };
            text.insert(known.map_or(end, |at| at + 1), block);
        }
        before = section;
    }
    text.iter().fold(head, |text, block| text + &block.comment + &block.lines)
}

impl Block {
    /// Takes over the value of another block, and what its comment says beyond this one's.
    fn replace_with(&mut self, above: Self) {
        let said = above.comment.trim();
        if self.comment.trim().is_empty() && !said.is_empty() {
            self.comment = above.comment;
        } else if !self.comment.contains(said) {
            self.comment.extend([said, "\n"]);
        }
        self.lines = above.lines;
    }
}

/// Takes a text apart: the comment at its head, which ends with a blank line, and the rest.
fn blocks(text: &str) -> (String, Vec<Block>) {
    let head = text.split_inclusive('\n').take_while(|line| line.starts_with('#'));
    let n_bytes = head.map(str::len).sum();
    let has_head = text[n_bytes..].starts_with('\n');
    let (head, rest) = text.split_at(if has_head { n_bytes } else { 0 });
    let (mut blocks, mut next, mut is_open) = (Vec::<Block>::new(), Block::default(), false);
    for line in rest.split_inclusive('\n') {
        let trimmed = line.trim();
        match blocks.last_mut() {
            Some(list) if is_open => {
                list.lines += line;
                is_open = !trimmed.starts_with(']');
                continue;
            }
            _ if trimmed.is_empty() || trimmed.starts_with('#') => {
                next.comment += line;
                continue;
            }
            _ => {}
        }
        is_open = trimmed.ends_with('[');
        trimmed.split(" =").next().unwrap_or_default().clone_into(&mut next.key);
        if trimmed.starts_with('[') {
            next.section = std::mem::take(&mut next.key);
        }
        next.lines = format!("{}\n", line.trim_end());
        blocks.push(next.clone());
        (next.comment, next.key) = (String::new(), String::new());
    }
    (head.to_owned(), blocks)
}
