//! Answers that `buildbox-casd` never gives, from a small server in this process.

use std::sync::Arc;

use tonic::Code;

use super::client::{Client, WRITTEN};
use super::fake::{Fake, Script};
use crate::reapi::CallError;

const BLAKE3: i32 = 9;
const SHA256: i32 = 1;

fn server() -> Script {
    Script { functions: vec![SHA256], updates: true, ..Script::default() }
}

#[test]
fn results_are_shared_with_either_digest_function_and_small_batches() {
    for (functions, batch) in
        [(vec![SHA256], 0), (vec![SHA256, BLAKE3], 0), (vec![BLAKE3], 100_000), (vec![SHA256], 4_193_280)]
    {
        let is_blake3 = functions.contains(&BLAKE3);
        let fake = Fake::start(Script { functions, batch, ..server() });
        let first = Client::new(&[]).publishing();
        let ran = first.run(&fake.address);
        assert_eq!((ran.written.as_deref(), ran.ids().len()), (Some(WRITTEN), 0), "{:?}", ran.warnings);
        let second = Client::new(&[&first]).run(&fake.address);
        assert_eq!((second.ran.as_str(), second.written.as_deref()), ("", Some(WRITTEN)));
        let script = fake.script();
        if is_blake3 {
            let right = |(hash, bytes): (&String, &Vec<u8>)| *hash == cache::Digest::of(bytes).to_string();
            assert!(script.blobs.iter().all(right), "the server has digests of its own function");
            assert!(script.calls.iter().any(|call| call.contains("/blobs/blake3/")), "{:?}", script.calls);
        }
        let limit = if batch == 0 { 4 << 20 } else { batch as usize };
        assert!(script.largest <= limit.max(256 << 10), "{} bytes at once", script.largest);
    }
}

#[test]
fn failures_that_pass_are_repeated() {
    let calls = ["capabilities", "find", "missing", "batch update", "write", "update", "batch read", "read"];
    let codes = [
        Code::Unavailable,
        Code::Aborted,
        Code::Internal,
        Code::Unknown,
        Code::DeadlineExceeded,
        Code::ResourceExhausted,
    ];
    for call in calls {
        for code in codes {
            let fake = Fake::start(Script { failures: vec![(call, code, 2)], ..server() });
            let first = Client::new(&[]).publishing();
            let ran = first.run(&fake.address);
            assert_eq!((ran.traffic.stored, ran.ids().len()), (4, 0), "{call} {code:?}: {:?}", ran.warnings);
            let second = Client::new(&[&first]).run(&fake.address);
            assert_eq!((second.ran.as_str(), second.ids().len()), ("", 0), "{call} {code:?}");
            assert_eq!(second.written.as_deref(), Some(WRITTEN));
        }
    }
}

/// After the last attempt, the outcome is one warning, and the bytes are right.
#[test]
fn failures_that_stay_cost_one_warning() {
    for call in ["find", "missing", "batch update", "write", "update"] {
        for code in
            [Code::Unavailable, Code::PermissionDenied, Code::ResourceExhausted, Code::InvalidArgument]
        {
            let fake = Fake::start(Script { failures: vec![(call, code, usize::MAX)], ..server() });
            let client = Client::new(&[]).publishing();
            let shared = Arc::new(client.connect(&fake.address).expect("connects"));
            let engine = client.engine().sharing(shared.clone());
            let ran = client.run_on(&engine, |_, _| {});
            assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{call} {code:?}");
            let id = if call == "find" { "remote-lost" } else { "remote-store" };
            assert_eq!(ran.ids(), [id], "{call} {code:?}: {:?}", ran.warnings);
            // Each node may have begun before the first failure was final; after that, nothing is tried.
            let passes = matches!(code, Code::Unavailable | Code::ResourceExhausted);
            let (tried, most) = (fake.count(call), if passes { 3 } else { 1 });
            assert!(tried >= most && tried <= 4 * most, "{call} {code:?}: {tried} calls");
            drop(engine);
            client.forget();
            let again = client.run_on(&client.engine().sharing(shared), |_, _| {});
            assert_eq!((again.written.as_deref(), again.ids().len()), (Some(WRITTEN), 0));
            assert_eq!(fake.count(call), tried, "{call} {code:?}");
        }
    }
    // A failure while fetching.
    for (call, code) in
        [("batch read", Code::NotFound), ("batch read", Code::DataLoss), ("find", Code::PermissionDenied)]
    {
        let fake = Fake::start(server());
        let first = Client::new(&[]).publishing();
        first.run(&fake.address);
        fake.script().failures = vec![(call, code, usize::MAX)];
        let ran = Client::new(&[&first]).run(&fake.address);
        assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{call} {code:?}: {:?}", ran.warnings);
    }
}

#[test]
fn an_interrupted_download_continues_where_it_ended() {
    let fake = Fake::start(server());
    let first = Client::new(&[]).publishing();
    first.run(&fake.address);
    let engine = first.engine();
    let (key, blob) = engine
        .store()
        .record_keys()
        .expect("keys")
        .into_iter()
        .find_map(|key| {
            let blobs = engine::blobs_of(&engine.store().get_record(&key)?);
            let large = |blob: &cache::Digest| {
                engine.store().get_blob(blob).is_ok_and(|bytes| bytes.is_some_and(|b| b.len() > 1 << 20))
            };
            Some((key, blobs.into_iter().find(large)?))
        })
        .expect("a large value");
    fake.script().break_after = Some(300_000);
    let shared = Client::new(&[&first]).connect(&fake.address).expect("connects");
    let bytes = engine::SharedResults::fetch(&shared, &key, &blob, &false.into()).expect("no error");
    assert_eq!(cache::Digest::of(&bytes.expect("the value")), blob);
    let script = fake.script();
    let offsets: Vec<&str> = script.calls.iter().filter_map(|call| call.split(" from ").nth(1)).collect();
    assert_eq!(offsets, ["0", "300000"]);
}

#[test]
fn a_server_that_does_not_fit_is_refused() {
    let connect =
        |script: Script| Client::new(&[]).connect(&Fake::start(script).address).err().expect("refused");
    let error = connect(Script { functions: vec![2, 4], ..server() });
    assert!(
        matches!(&error, CallError::Refused { .. }) && error.to_string().contains("neither BLAKE3"),
        "{error}"
    );
    let error = connect(Script { failures: vec![("capabilities", Code::Unauthenticated, 1)], ..server() });
    assert!(matches!(error, CallError::Refused { .. }), "{error}");
    // A server that takes no results is read, and says so once to those who want to write.
    let fake = Fake::start(Script { updates: false, ..server() });
    let ran = Client::new(&[]).publishing().run(&fake.address);
    assert_eq!(
        (ran.written.as_deref(), ran.ids(), fake.count("update")),
        (Some(WRITTEN), vec!["remote-store"], 0)
    );
    assert_eq!(Client::new(&[]).run(&fake.address).ids().len(), 0);
    // More bytes than the stated size are never taken.
    let fake = Fake::start(server());
    let first = Client::new(&[]).publishing();
    first.run(&fake.address);
    fake.script().surplus = 1 << 20;
    let ran = Client::new(&[&first]).run(&fake.address);
    assert_eq!(ran.written.as_deref(), Some(WRITTEN), "{:?}", ran.warnings);
    assert_eq!(ran.ids(), ["remote-wrong"], "{:?}", ran.warnings);
}
