//! Folders for results.

use std::io;
use std::path::Path;

/// Creates a folder, and those that it is in, unless it is there. An error names the folder.
pub fn create(folder: &Path) -> io::Result<()> {
    std::fs::create_dir_all(folder).map_err(|why| {
        let reason = match why.kind() {
            io::ErrorKind::AlreadyExists => "a file of this name is there".into(),
            _ => why.to_string(),
        };
        io::Error::new(why.kind(), format!("cannot make the folder {}: {reason}", folder.display()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_folder_and_what_is_in_its_place() {
        let outer = tempfile::tempdir().unwrap();
        let file = outer.path().join("results");
        std::fs::write(&file, "").unwrap();
        let said = create(&file).unwrap_err().to_string();
        assert!(said.contains("results") && said.contains("a file of this name"), "{said}");
        let said = create(&file.join("inner")).unwrap_err().to_string();
        assert!(said.contains("results/inner"), "{said}");
        create(&outer.path().join("a/b")).unwrap();
        create(&outer.path().join("a/b")).unwrap();
    }
}
