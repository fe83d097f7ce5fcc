//! Files of digests that results are compared with.

use std::path::Path;

use engine::Digest;

/// Compares results with the lines of a file. Each result has the name of a kind, a key and the digests of outputs. If
/// the environment variable `UPDATE_GOLDEN` is set, writes the file.
pub(crate) fn compare<'r>(
    file: &Path,
    results: impl Iterator<Item = (&'static str, &'r (Digest, Vec<Digest>))>,
) -> Vec<String> {
    // Half of a digest suffices, and keeps the lines short.
    let half = |digest: &Digest| digest.to_string()[..32].to_owned();
    let line = |(kind, (key, outputs)): (&str, &(Digest, Vec<Digest>))| {
        let outputs: Vec<String> = outputs.iter().map(half).collect();
        [kind.to_owned(), half(key), outputs.join(" ")]
    };
    let now: Vec<[String; 3]> = results.map(line).collect();
    let unreadable = |error: std::io::Error| vec![format!("`{}`: {error}", file.display())];
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        let lines: String = now.iter().map(|line| line.join(" ") + "\n").collect();
        return std::fs::write(file, lines).err().map(unreadable).unwrap_or_default();
    }
    let golden = match std::fs::read_to_string(file) {
        Ok(golden) => golden,
        Err(error) => return unreadable(error),
    };
    let golden: Vec<Vec<&str>> = golden.lines().map(|line| line.splitn(3, ' ').collect()).collect();
    let mut problems = Vec::new();
    for [kind, key, outputs] in &now {
        if !golden.iter().any(|line| line[0] == kind) {
            problems.push(format!("`{kind}` has no line in the file of digests: run with UPDATE_GOLDEN=1"));
        }
        let differs =
            |line: &Vec<&str>| line.get(1) == Some(&key.as_str()) && line.get(2) != Some(&outputs.as_str());
        if golden.iter().any(differs) {
            problems
                .push(format!("`{kind}`: output changed, VERSION did not; raise it, then UPDATE_GOLDEN=1"));
        }
    }
    problems
}
