//! How local models want to be talked to: the marks around a conversation, and those that end an answer.
//!
//! A model that is given plain text, or whose end mark is not known, rambles. Two families of marks cover the
//! Llama-like models that can be loaded here.

/// A family of conversation marks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChatFormat {
    /// `<|im_start|>role ... <|im_end|>`: `SmolLM2`, Qwen.
    ChatMl,
    /// `<|start_header_id|>role<|end_header_id|> ... <|eot_id|>`: Llama 3.
    Llama3,
}

impl ChatFormat {
    /// Recognises the family from the template that comes with a model's weights.
    pub fn of_template(template: &str) -> Option<Self> {
        if template.contains("<|im_start|>") {
            Some(Self::ChatMl)
        } else if template.contains("<|start_header_id|>") {
            Some(Self::Llama3)
        } else {
            None
        }
    }

    /// Writes a conversation of two, up to where the model's answer begins.
    ///
    /// The mark that begins a text is part of what is written where the family has one, so a tokenizer must not add
    /// another.
    pub fn render(self, system: &str, user: &str) -> String {
        match self {
            Self::ChatMl => format!(
                "<|im_start|>system\n{system}<|im_end|>\n<|im_start|>user\n{user}<|im_end|>\n<|im_start|>assistant\n"
            ),
            Self::Llama3 => format!(
                "<|begin_of_text|><|start_header_id|>system<|end_header_id|>\n\n{system}<|eot_id|>\
                 <|start_header_id|>user<|end_header_id|>\n\n{user}<|eot_id|>\
                 <|start_header_id|>assistant<|end_header_id|>\n\n"
            ),
        }
    }

    /// Lists the tokens that end an answer; all of them must stop it.
    pub const fn stops(self) -> &'static [&'static str] {
        match self {
            Self::ChatMl => &["<|im_end|>", "<|endoftext|>"],
            Self::Llama3 => &["<|eot_id|>", "<|end_of_text|>"],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn llama_3_begins_once_and_ends_with_its_answer() {
        let text = ChatFormat::Llama3.render("S", "U");
        assert_eq!(
            text,
            "<|begin_of_text|><|start_header_id|>system<|end_header_id|>\n\nS<|eot_id|><|start_header_id|>user\
             <|end_header_id|>\n\nU<|eot_id|><|start_header_id|>assistant<|end_header_id|>\n\n"
        );
        // The base model's end alone would let the instruct model ramble.
        assert!(ChatFormat::Llama3.stops().contains(&"<|eot_id|>"));
    }

    #[test]
    fn a_family_is_known_by_its_marks() {
        let chatml =
            "{% for message in messages %}{{'<|im_start|>' + message['role']}}{% endfor %}";
        assert_eq!(ChatFormat::of_template(chatml), Some(ChatFormat::ChatMl));
        assert_eq!(ChatFormat::of_template("[INST] {{ x }} [/INST]"), None);
        assert!(ChatFormat::ChatMl.render("S", "U").ends_with("<|im_start|>assistant\n"));
    }
}
