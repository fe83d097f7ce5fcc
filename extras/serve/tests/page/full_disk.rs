//! A full disk: a limit of the length of files makes the system refuse to write, for root as well.

use std::process::Command;

use crate::lab::{GRAPH, Lab, digest_of};

/// The variable that makes the test below run with the limit.
const LIMITED: &str = "LIGHTHARMONY_TEST_LIMITED";

/// The test runs itself in a process whose files are at most 512 bytes long; the signal that would end the process is
/// ignored. This test fails if an error of writing replaces the file, or if it counts as a change.
#[cfg(unix)]
#[test]
fn a_full_disk_is_named_and_the_file_has_its_old_content() {
    if std::env::var_os(LIMITED).is_some() {
        return limited();
    }
    let program = std::env::current_exe().unwrap();
    let name = "full_disk::a_full_disk_is_named_and_the_file_has_its_old_content";
    let shell = "trap '' XFSZ; exec \"$0\" \"$1\" --exact --nocapture";
    let output =
        Command::new("sh").args(["-c", shell]).arg(program).arg(name).env(LIMITED, "1").output().unwrap();
    let text =
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("1 passed"), "{text}");
}

/// Sets the limit of this process.
#[cfg(unix)]
fn limit(bytes: &str) {
    let own = std::process::id().to_string();
    let length = format!("--fsize={bytes}");
    let set = Command::new("prlimit").args([length.as_str(), "--pid", &own]).status();
    assert!(set.unwrap().success());
}

#[cfg(unix)]
fn limited() {
    let lab = Lab::new(GRAPH);
    lab.idle();
    let digest = digest_of(GRAPH);
    // The soft limit; the hard limit stays.
    limit("512:");
    let refused = lab.set("pose", "yaw_deg", &[], Some("1.0"));
    let undo = lab.post("/undo", &format!("{{\"digest\":\"{digest}\"}}"));
    limit("unlimited:");
    assert_eq!((refused.status, refused.json()["code"].as_str()), (507, Some("unwritten")));
    assert!(refused.json()["why"].as_str().unwrap().contains("the disk is full"), "{}", refused.json());
    assert_eq!(undo.status, 409, "there is nothing to undo");
    assert_eq!(lab.text(), GRAPH);
    let left = std::fs::read_dir(lab.folder.path()).unwrap().flatten();
    let left: Vec<_> = left.filter(|entry| entry.file_name().to_string_lossy().contains("temp")).collect();
    assert!(left.is_empty(), "no temporary file is left: {left:?}");
    assert_eq!(lab.set("pose", "yaw_deg", &[], Some("1.0")).status, 200, "the disk has room again");
    assert_eq!(lab.text(), GRAPH.replace("yaw_deg: 30.0", "yaw_deg: 1.0"));
}
