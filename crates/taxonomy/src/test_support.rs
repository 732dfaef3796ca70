//! What tests make databases of.

/// Writes what a small database begins with: all but its sentences.
pub(crate) fn header(topics: &[&str]) -> String {
    format!(
        r#"schema = 1
domain = "road"
fidelity = "authored"
generator = "a person"
rater = "a person"
embedder = "none"
theta = 70
words = [2, 5]
topics = {topics:?}
config = ""
"#
    )
}
