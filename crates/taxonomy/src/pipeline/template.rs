//! Prompts with holes: `{{topic}}` is replaced, anything else stays as it is.

use std::collections::BTreeMap;

use super::error::PipelineError;

/// What a prompt may ask for, by name.
pub type Variables = BTreeMap<&'static str, String>;

/// Fills a template's holes. What is put in is not searched for holes again.
///
/// # Errors
///
/// [`PipelineError::UnknownVariable`] naming the variable and those that there are;
/// [`PipelineError::OpenVariable`] naming the line.
pub fn render(name: &str, template: &str, variables: &Variables) -> Result<String, PipelineError> {
    let mut out = String::with_capacity(template.len());
    let mut rest = template;
    while let Some(start) = rest.find("{{") {
        out.push_str(&rest[..start]);
        let inside = &rest[start + 2..];
        let Some(end) = inside.find("}}") else {
            let line = 1 + template[..template.len() - inside.len()].matches('\n').count();
            return Err(PipelineError::OpenVariable { template: name.to_owned(), line });
        };
        let variable = inside[..end].trim();
        let Some(value) = variables.get(variable) else {
            return Err(PipelineError::UnknownVariable {
                template: name.to_owned(),
                variable: variable.to_owned(),
                known: variables.keys().copied().collect::<Vec<_>>().join(", "),
            });
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

    fn variables() -> Variables {
        BTreeMap::from([("topic", "ascend".to_owned()), ("k", "{{l}}".to_owned())])
    }

    #[test]
    fn holes_are_filled_once() {
        let text = render("generate", "Say {{topic}} by {{ k }}. {a} }}", &variables()).unwrap();
        assert_eq!(text, "Say ascend by {{l}}. {a} }}");
    }

    #[test]
    fn an_unknown_or_open_variable_is_named() {
        let error = render("generate", "Say {{topik}}", &variables()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "prompt template `generate` has the unknown variable `topik`; known: k, topic"
        );
        let error = render("generate", "one\ntwo {{topic", &variables()).unwrap_err();
        let says = "prompt template `generate` opens a variable on line 2 and never closes it";
        assert_eq!(error.to_string(), says);
    }
}
