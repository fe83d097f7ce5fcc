//! A real server.

use std::net::{TcpListener, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tempfile::TempDir;

const VARIABLE: &str = "LIGHTHARMONY_BUILDBOX";

/// A running `buildbox-casd`, which ends when this is dropped.
pub struct Casd {
    folder: TempDir,
    port: u16,
    child: Option<Child>,
    /// True if it executes actions.
    executes: bool,
}

/// The folders of this machine that programs in the sandbox of `buildbox-run` see, each with its path there.
const MOUNTS: [&str; 4] = ["/usr:/usr", "/usr/lib:/lib", "/usr/lib64:/lib64", "/usr/bin:/bin"];

impl Casd {
    /// Starts a server with an empty cache; `None` if the program is not available.
    ///
    /// # Panics
    /// If the variable names a folder without the program.
    pub fn start() -> Option<Self> {
        Self::of(false)
    }

    /// Starts a server that executes actions, two at a time; `None` if a program is not available, or if bubblewrap
    /// may not create namespaces.
    pub fn executing() -> Option<Self> {
        let sandbox = Command::new("bwrap").args(["--ro-bind", "/", "/", "--unshare-all", "true"]).output();
        if !sandbox.is_ok_and(|output| output.status.success()) {
            #[allow(clippy::print_stderr, reason = "a test that is left out must say so")]
            {
                eprintln!("left out: bubblewrap is not installed or may not create namespaces");
            }
            return None;
        }
        Self::of(true)
    }

    fn of(executes: bool) -> Option<Self> {
        if std::env::var_os(VARIABLE).is_none() {
            // The name of the test that was left out is in the line above.
            #[allow(clippy::print_stderr, reason = "a test that is left out must say so")]
            {
                eprintln!("left out: {VARIABLE} does not name the folder of buildbox-casd");
            }
            return None;
        }
        let port =
            TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()).expect("a port").port();
        let mut server = Self { folder: tempfile::tempdir().expect("a folder"), port, child: None, executes };
        server.resume();
        Some(server)
    }

    /// Starts the server, with the cache that it had before.
    pub fn resume(&mut self) {
        let programs = PathBuf::from(std::env::var_os(VARIABLE).expect("the variable"));
        let program = programs.join("buildbox-casd");
        let mut execution = Vec::new();
        if self.executes {
            let run = programs.join("buildbox-run");
            execution.push(format!("--buildbox-run={}", run.display()));
            execution.extend(["--jobs=2", "--cache-failures=false"].map(str::to_owned));
            execution.extend(MOUNTS.map(|mount| format!("--runner-arg=--ro-bind-mount={mount}")));
        }
        let child = Command::new(&program)
            .args([
                "--bind",
                &format!("127.0.0.1:{}", self.port),
                "--quota-high",
                "1G",
                "--log-level",
                "error",
            ])
            .args(execution)
            .arg(self.folder.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap_or_else(|error| panic!("{}: {error}", program.display()));
        self.child = Some(child);
        let begin = Instant::now();
        while TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            assert!(begin.elapsed() < Duration::from_secs(20), "buildbox-casd does not listen");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Ends the server at once.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.kill().expect("kills its own child");
            child.wait().expect("waits for its own child");
        }
    }

    /// Stops or continues the process, which keeps its connections.
    pub fn freeze(&self, frozen: bool) {
        let signal = if frozen { "-STOP" } else { "-CONT" };
        let id = self.child.as_ref().expect("it runs").id().to_string();
        assert!(Command::new("kill").args([signal, &id]).status().expect("kill").success());
    }

    pub fn address(&self) -> String {
        format!("grpc://127.0.0.1:{}", self.port)
    }

    /// The files in which the server keeps blobs, in order.
    pub fn blobs(&self) -> Vec<PathBuf> {
        files_below(self.folder.path().join("cas/objects"))
    }

    /// The files in which the server keeps results, in order.
    pub fn results(&self) -> Vec<PathBuf> {
        files_below(self.folder.path().join("actioncache/objects"))
    }
}

fn files_below(folder: PathBuf) -> Vec<PathBuf> {
    let (mut found, mut open) = (Vec::new(), vec![folder]);
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() { open.push(path) } else { found.push(path) }
        }
    }
    found.sort();
    found
}

impl Drop for Casd {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
