//! Running a program in a process group of its own.

use std::ffi::OsString;
use std::fs::File;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use engine::Context;

use super::error::ProgramError;
use super::folder::WorkFolder;
use super::log::Log;

/// Time between two looks at a program in its first second, and later.
const PAUSES: [Duration; 2] = [Duration::from_millis(5), Duration::from_millis(50)];

/// A call of a program.
pub struct Call<'a> {
    /// Name of the program for error messages, with the step if it has several.
    pub name: &'a str,
    /// Path of the program.
    pub program: &'a Path,
    /// The arguments, which no shell reads.
    pub arguments: Vec<OsString>,
    /// Variables of the environment, in addition to those of this process.
    pub environment: &'a [(&'a str, &'a str)],
}

/// Runs a program in `folder` until it ends, and calls `line` with each line that it writes. Returns the last lines
/// of its output as text for error messages.
///
/// # Errors
/// If it cannot be started, if its exit status is not 0, or if the run is cancelled. The program and all processes
/// that it started in its process group are then killed.
pub fn run(
    call: Call<'_>,
    folder: &WorkFolder,
    cx: &Context,
    line: &mut dyn FnMut(&str),
) -> Result<String, ProgramError> {
    let paths = [folder.log("stdout"), folder.log("stderr")];
    let create = |path: &Path| {
        File::create(path).map_err(|source| ProgramError::Io {
            what: "create",
            path: path.to_owned(),
            source,
        })
    };
    let mut command = Command::new(call.program);
    command
        .args(&call.arguments)
        .envs(call.environment.iter().copied())
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(create(&paths[0])?)
        .stderr(create(&paths[1])?);
    // Windows has no process groups that end together. Its job objects would need `unsafe` code, which is forbidden here;
    // so processes that the program starts may outlive it there.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    let started = command.spawn();
    let child =
        started.map_err(|source| ProgramError::NotStarted { program: call.name.to_owned(), source })?;
    let mut group = Group { child, is_over: false };
    let mut logs = paths.map(|path| Log::open(&path));
    let start = Instant::now();
    let status = loop {
        logs.iter_mut().for_each(|log| log.read(line));
        if cx.cancelled() {
            return Err(ProgramError::Stopped);
        }
        match group.ended() {
            Ok(Some(status)) => break status,
            Ok(None) => std::thread::sleep(PAUSES[usize::from(start.elapsed() > Duration::from_secs(1))]),
            Err(source) => {
                return Err(ProgramError::NotStarted { program: call.name.to_owned(), source });
            }
        }
    };
    logs.iter_mut().for_each(|log| log.read(line));
    let [stdout, stderr] = logs.map(|log| log.last());
    // Most programs write errors to standard error; some write everything to standard output.
    let last = match (stderr.is_empty(), stdout.is_empty()) {
        (false, _) => format!("the last lines of its standard error are:\n  {}", stderr.join("\n  ")),
        (true, false) => format!("the last lines of its standard output are:\n  {}", stdout.join("\n  ")),
        (true, true) => "it wrote nothing to standard output or standard error".to_owned(),
    };
    if status.success() {
        return Ok(last);
    }
    Err(ProgramError::Failed { program: call.name.to_owned(), status, output: last })
}

/// A program and the processes of its group. They are killed when this value is dropped.
struct Group {
    child: Child,
    /// True if the program has been waited for. Its number may belong to another process then.
    is_over: bool,
}

impl Group {
    /// The exit status of the program, if it has ended. The other processes of its group are killed then, while the
    /// number of the group still belongs to the program. Only `waitid` of Unix looks at a process without releasing its
    /// number.
    #[cfg(unix)]
    fn ended(&mut self) -> std::io::Result<Option<ExitStatus>> {
        use rustix::process::{WaitId, WaitIdOptions, waitid};
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let Some(pid) = self.pid() else { return self.child.try_wait() };
        if waitid(WaitId::Pid(pid), options)?.is_none() {
            return Ok(None);
        }
        self.end().map(Some)
    }

    /// The exit status of the program, if it has ended. There is no group to kill.
    #[cfg(not(unix))]
    fn ended(&mut self) -> std::io::Result<Option<ExitStatus>> {
        let status = self.child.try_wait();
        self.is_over = matches!(status, Ok(Some(_)));
        status
    }

    /// Kills the processes of the group, and waits for the program.
    fn end(&mut self) -> std::io::Result<ExitStatus> {
        self.kill();
        self.is_over = true;
        self.child.wait()
    }

    /// The number of the program, which is also that of its group.
    #[cfg(unix)]
    fn pid(&self) -> Option<rustix::process::Pid> {
        rustix::process::Pid::from_raw(i32::try_from(self.child.id()).ok()?)
    }

    /// Kills all processes of the group. An error means that all of them have ended.
    #[cfg(unix)]
    fn kill(&mut self) {
        if let Some(pid) = self.pid() {
            let _ = rustix::process::kill_process_group(pid, rustix::process::Signal::KILL);
        }
    }

    /// Kills the program. The processes that it started are not killed; see [`run`].
    #[cfg(not(unix))]
    fn kill(&mut self) {
        let _ = self.child.kill();
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        if !self.is_over {
            let _ = self.end();
        }
    }
}
