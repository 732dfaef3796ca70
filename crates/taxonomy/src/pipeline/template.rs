//! Prompts with holes: `{{topic}}` is replaced, anything else stays as it is.

use std::collections::BTreeMap;

use super::error::PipelineError;

/// What a prompt may ask for, by name.
pub(super) type Variables = BTreeMap<&'static str, String>;

/// Fills a template's holes. What is put in is not searched for holes again.
///
/// # Errors
///
/// [`PipelineError::Unusable`] if a variable is unknown, with its name, or is never closed, with its line.
pub(super) fn render(
    name: &str,
    template: &str,
    variables: &Variables,
) -> Result<String, PipelineError> {
    let mut out = String::with_capacity(template.len());
    let mut rest = template;
    while let Some(start) = rest.find("{{") {
        out.push_str(&rest[..start]);
        let inside = &rest[start + 2..];
        let Some(end) = inside.find("}}") else {
            let line = 1 + template[..template.len() - inside.len()].matches('\n').count();
            return Err(PipelineError::Unusable(format!(
                "prompt template `{name}` opens a variable on line {line} and never closes it"
            )));
        };
        let variable = inside[..end].trim();
        let Some(value) = variables.get(variable) else {
            let known = variables.keys().copied().collect::<Vec<_>>().join(", ");
            return Err(PipelineError::Unusable(format!(
                "prompt template `{name}` has the unknown variable `{variable}`; known: {known}"
            )));
        };
        out.push_str(value);
        rest = &inside[end + 2..];
    }
    out.push_str(rest);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_are_filled_once_and_wrong_ones_are_named() {
        let variables = BTreeMap::from([("topic", "ascend".to_owned()), ("k", "{{l}}".to_owned())]);
        let fill = |template| render("generate", template, &variables);
        let text = fill("Say {{topic}} by {{ k }}. {a} }}").unwrap();
        assert_eq!(text, "Say ascend by {{l}}. {a} }}");
        let says = "prompt template `generate` has the unknown variable `topik`; known: k, topic";
        assert_eq!(fill("Say {{topik}}").unwrap_err().to_string(), says);
        let says = "prompt template `generate` opens a variable on line 2 and never closes it";
        assert_eq!(fill("one\ntwo {{topic").unwrap_err().to_string(), says);
    }
}
