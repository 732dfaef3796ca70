//! A text changed as another one says, with its comments kept: how a variant is printed as a complete file.

use crate::layers::BASE;

/// A key or a section's header (then `key` is empty), with what stands above it.
#[derive(Clone, Debug, Default)]
struct Block {
    section: String,
    key: String,
    comment: String,
    lines: String,
}

/// Returns `below` with the values of `above`, which also gives the comment at the head; keys that only `above` has are
/// added to their sections, and sections at the end.
pub(crate) fn edited(below: &str, above: &str) -> String {
    let ((_, below), (mut text, mut above)) = (blocks(below), blocks(above));
    above.retain(|block| block.key != BASE);
    for (i, block) in below.iter().enumerate() {
        let is_same = |other: &Block| other.section == block.section && other.key == block.key;
        let replaced = above.iter().position(is_same).map(|at| above.remove(at));
        let written = replaced.unwrap_or_else(|| block.clone());
        // A default without a comment takes the comment of the value that replaces it.
        let is_bare = block.comment.trim().is_empty() && !written.comment.trim().is_empty();
        text += if is_bare { &written.comment } else { &block.comment };
        text += &written.lines;
        if below.get(i + 1).is_none_or(|next| next.section != block.section) {
            let added = above.extract_if(.., |other| other.section == block.section);
            added.for_each(|block| text += &(block.comment + &block.lines));
        }
    }
    for block in above {
        text += &(block.comment + &block.lines);
    }
    text
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
