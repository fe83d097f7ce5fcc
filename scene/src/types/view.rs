//! Names of views.

use engine::NodeError;

/// Checks that the name of a view can be part of a file name.
pub fn check_name(name: &str) -> Result<(), NodeError> {
    if name.is_empty()
        || name.contains(['/', '\\', '{', '}'])
        || name.contains(char::is_control)
        || name == ".."
    {
        return Err(NodeError::new(format!(
            "`{name}` cannot be the name of a view, because it becomes part of file names"
        ))
        .at("name")
        .hint("use letters, digits, `-` and `_`"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_would_leave_the_folder_are_refused() {
        assert!(
            check_name("../x").is_err() && check_name("a{view}").is_err() && check_name("view_0").is_ok()
        );
    }
}
