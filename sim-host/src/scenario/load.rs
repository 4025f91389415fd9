//! From a file to a [`Scenario`], or to one line that says what is wrong.
use super::Scenario;
use std::path::{Path, PathBuf};

/// Why a scenario cannot be flown. Its text is one line.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {reason}; give the path of a scenario, such as scenarios/flight.toml", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The system's words.
        reason: std::io::Error,
    },
    /// The file is not the TOML of a scenario.
    #[error("{}:{line}: {key}: {found}: {reason}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Path of the key.
        key: String,
        /// The text there.
        found: String,
        /// What is wrong and what is allowed.
        reason: String,
    },
    /// A value is out of its range.
    #[error("{}: {key} = {value}: must be {allowed}", file.display())]
    OutOfRange {
        /// The file.
        file: PathBuf,
        /// Path of the key.
        key: String,
        /// The value found.
        value: String,
        /// What is allowed.
        allowed: String,
    },
}

impl Scenario {
    /// Reads and checks the scenario in `file`.
    pub fn load(file: &Path) -> Result<Self, ScenarioError> {
        Self::load_with(file, &[])
    }

    /// Reads and checks the scenario in `file` with the tables of the files `more` after it, as if they were one file.
    pub fn load_with(file: &Path, more: &[PathBuf]) -> Result<Self, ScenarioError> {
        let mut text = String::new();
        let mut name = String::new();
        for file in std::iter::once(file).chain(more.iter().map(PathBuf::as_path)) {
            let part = std::fs::read_to_string(file)
                .map_err(|reason| ScenarioError::Unreadable { file: file.to_owned(), reason })?;
            let (line, plus) = if text.is_empty() { ("", "") } else { ("\n", " + ") };
            text.extend([line, &part]);
            name.extend([plus, &file.display().to_string()]);
        }
        Self::parse(&text, Path::new(&name))
    }

    /// Reads and checks a scenario from `text`; `file` is named in errors.
    pub fn parse(text: &str, file: &Path) -> Result<Self, ScenarioError> {
        let malformed = |error: &toml::de::Error, key: String| {
            let span = error.span().unwrap_or(0..0);
            let before = &text[..span.start.min(text.len())];
            let line = before.matches('\n').count();
            // Where nothing is, as at an unclosed bracket, the whole line tells more.
            let found = text.get(span).and_then(|s| s.lines().next()).filter(|found| !found.is_empty());
            let found = found.or_else(|| text.lines().nth(line)).unwrap_or_default();
            ScenarioError::Malformed {
                file: file.to_owned(),
                line: line + 1,
                key,
                found: found.trim().to_owned(),
                reason: error.message().replace('\n', " "),
            }
        };
        let document = toml::Deserializer::parse(text).map_err(|e| malformed(&e, "TOML".to_owned()))?;
        let mut scenario: Self =
            serde_path_to_error::deserialize(document).map_err(|e| malformed(e.inner(), e.path().to_string()))?;
        scenario.check().map_err(|wrong| ScenarioError::OutOfRange {
            file: file.to_owned(),
            key: wrong.key,
            value: wrong.value,
            allowed: wrong.allowed,
        })?;
        text.clone_into(&mut scenario.text);
        Ok(scenario)
    }
}
