//! Programs that end well, that fail, that leave processes, and that are cancelled.

use std::time::{Duration, Instant};

use super::*;
use testing::context;

const SHELL: &str = "/bin/sh";

fn call(script: &str, cx: &engine::Context) -> (Result<String, ProgramError>, Vec<String>, WorkFolder) {
    let folder = WorkFolder::new().expect("is made");
    let call = Call {
        name: "sh",
        program: std::path::Path::new(SHELL),
        arguments: vec!["-c".into(), script.into()],
        environment: &[("LIGHTHARMONY_TEST", "set")],
    };
    let mut lines = Vec::new();
    let result = run(call, &folder, cx, &mut |line| lines.push(line.to_owned()));
    (result, lines, folder)
}

#[test]
fn a_program_runs_in_its_folder_and_its_outputs_are_read() {
    let (result, lines, folder) =
        call("pwd; echo $LIGHTHARMONY_TEST; cat; echo made > out/a.txt; mkdir out/b", &context());
    result.expect("succeeds");
    assert_eq!(lines, [folder.path().display().to_string(), "set".to_owned()]);
    assert_eq!(folder.output("a.txt", "sh", "").expect("is there"), b"made\n");
    for missing in ["b", "c.txt"] {
        let error = folder.output(missing, "sh", "nothing").expect_err("is missing").to_string();
        assert!(error.contains(&format!("did not write `{missing}`; nothing")), "{error}");
    }
    let path = folder.path().to_owned();
    drop(folder);
    assert!(!path.exists());
}

/// This test fails if `output` does not resolve links.
#[test]
fn a_link_out_of_the_folder_is_refused() {
    let (result, _, folder) = call("ln -s /etc/passwd out/a; echo x > in; ln -s ../in out/b", &context());
    result.expect("succeeds");
    let error = folder.output("a", "sh", "").expect_err("leads out");
    assert!(matches!(error, ProgramError::Outside { .. }), "{error}");
    assert_eq!(folder.output("b", "sh", "").expect("stays inside"), b"x\n");
    for (file, inside) in
        [("a/b.ply", true), ("../a", false), ("/a", false), ("a/../b", false), ("", false), (".", false)]
    {
        assert_eq!(stays_inside(file), inside, "{file}");
    }
}

#[test]
fn a_failure_shows_the_last_lines_of_standard_error() {
    let (result, ..) =
        call("for i in 1 2 3 4 5 6 7 8 9 10; do echo line $i >&2; done; echo x; exit 7", &context());
    let error = result.expect_err("fails").to_string();
    assert!(
        error.contains("exit status: 7") && error.contains("line 3\n") && !error.contains("line 2\n"),
        "{error}"
    );
    let error = call("echo only; exit 1", &context()).0.expect_err("fails").to_string();
    assert!(error.contains("standard output are:\n  only"), "{error}");
    let error = call("exit 1", &context()).0.expect_err("fails").to_string();
    assert!(error.contains("wrote nothing"), "{error}");
}

fn is_alive(pid: &str) -> bool {
    std::fs::read_to_string(format!("/proc/{pid}/stat")).is_ok_and(|stat| !stat.contains(") Z "))
}

/// Waits until a process is gone.
fn is_gone(pid: &str) -> bool {
    let start = Instant::now();
    while is_alive(pid) && start.elapsed() < Duration::from_secs(5) {
        std::thread::sleep(Duration::from_millis(5));
    }
    !is_alive(pid)
}

/// This test fails if `Group::ended` does not kill the group.
#[cfg(target_os = "linux")]
#[test]
fn processes_that_a_program_leaves_are_killed() {
    let (result, lines, _) = call("sleep 100 & echo $!", &context());
    result.expect("succeeds");
    assert!(is_gone(&lines[0]), "{lines:?}");
}

/// This test fails if `kill` kills only the program itself.
#[cfg(target_os = "linux")]
#[test]
fn cancelling_kills_the_whole_group() {
    let cx = context();
    let folder = WorkFolder::new().expect("is made");
    let call = Call {
        name: "sh",
        program: std::path::Path::new(SHELL),
        arguments: vec!["-c".into(), "sleep 100 & echo $!; wait".into()],
        environment: &[],
    };
    let mut pid = String::new();
    let result = run(call, &folder, &cx, &mut |line| {
        line.clone_into(&mut pid);
        cx.stop();
    });
    assert!(matches!(result, Err(ProgramError::Stopped)));
    assert!(is_gone(&pid), "{pid}");
}

#[test]
fn programs_are_found_by_name_and_by_path() {
    let folder = tempfile::tempdir().expect("is made");
    let path = folder.path().join("tool");
    std::fs::write(&path, "#!/bin/sh\n").expect("is written");
    let error = find("./tool", folder.path()).expect_err("is not executable").to_string();
    assert!(error.contains("not an executable file"), "{error}");
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o755);
    std::fs::set_permissions(&path, mode).expect("is set");
    assert_eq!(find("./tool", folder.path()).expect("is there"), folder.path().join("./tool"));
    assert!(find("sh", folder.path()).expect("is installed").is_absolute());
    let error = find("no-such-program-at-all", folder.path()).expect_err("is missing").to_string();
    assert!(error.contains("was not found in the folders of `PATH`"), "{error}");
}
