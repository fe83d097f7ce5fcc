//! Clients that share results through a real server.

use engine::{Entry, SharedResults};

use super::casd::Casd;
use super::client::{Client, WRITTEN};
use crate::signed::seal;
use crate::testing::Numbers;

#[test]
fn a_second_client_computes_nothing_and_fetches_only_what_the_sink_needs() {
    let Some(server) = Casd::start() else { return };
    let first = Client::new(&[]).publishing();
    let ran = first.run(&server.address());
    assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("d e n w", Some(WRITTEN)), "{:?}", ran.warnings);
    assert_eq!((ran.traffic.found, ran.traffic.stored, ran.ids().len()), (0, 4, 0), "{:?}", ran.warnings);
    assert!(ran.traffic.bytes_up > 2_400_000, "{:?}", ran.traffic);

    let second = Client::new(&[&first]);
    let ran = second.run(&server.address());
    assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("", Some(WRITTEN)), "{:?}", ran.warnings);
    assert_eq!((ran.traffic.found, ran.traffic.stored, ran.traffic.values), (4, 0, 1));
    assert!(ran.traffic.bytes_down < 100, "{:?}", ran.traffic);

    // Without the server: every result is known, and a value that was not fetched is computed again when needed.
    let ran = second.run_alone();
    assert_eq!((ran.ran.as_str(), ran.outcome.totals.remade, ran.ids().len()), ("", 0, 0));
    std::fs::remove_file(second.path("out/w.txt")).expect("the file");
    let ran = second.run_alone();
    assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("", Some(WRITTEN)));

    // A value that was not fetched can be shown without the server: it is computed again.
    let graph = second.graph();
    let wire = engine::Wire { node: graph.find("d").expect("the node"), port: 0 };
    let value = second.engine().value::<Numbers>(&graph, wire).expect("the value");
    assert_eq!((value.0.len(), value.0[299_999]), (300_000, 599_998));

    // With it again: nothing is asked, since every record is in the store.
    let ran = second.run(&server.address());
    assert_eq!((ran.traffic.found, ran.traffic.values), (0, 0));
}

/// A value that was not fetched in the first run is fetched when a later run needs it.
#[test]
fn a_value_is_fetched_when_it_is_needed_later() {
    let Some(server) = Casd::start() else { return };
    let first = Client::new(&[]).publishing();
    first.run(&server.address());
    let keys = first.engine().store().record_keys().expect("keys");
    let second = Client::new(&[&first]);
    second.run(&server.address());
    // The record of `d` is here, and its value is not.
    let here = second.engine();
    let missing = keys.iter().find_map(|key| {
        let record = here.store().get_record(key)?;
        let stored = first.engine().store().get_record(key)?;
        let blob = *engine::blobs_of(&stored).iter().find(|blob| !here.store().has_blob(blob))?;
        assert!(!engine::blobs_of(&record).contains(&blob), "the record does not claim the value");
        Some((*key, blob))
    });
    let (key, blob) = missing.expect("a value that was not fetched");
    let shared = second.connect(&server.address()).expect("connects");
    let bytes = shared.fetch(&key, &blob, &false.into()).expect("falls back").expect("the value");
    assert_eq!(cache::Digest::of(&bytes), blob);
}

#[test]
fn results_of_unknown_keys_are_not_used_and_this_is_reported_once() {
    let Some(server) = Casd::start() else { return };
    let first = Client::new(&[]).publishing();
    first.run(&server.address());
    let other = Client::new(&[]);
    let ran = other.run(&server.address());
    assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("d e n w", Some(WRITTEN)));
    assert_eq!((ran.ids(), ran.traffic.found), (vec!["remote-untrusted"], 0));
    let public = first.key().public().to_string();
    assert!(ran.warnings[0].1.contains(&format!("lightharmony key trust {public}")), "{}", ran.warnings[0].1);

    other.trusted().trust(&first.key().public()).expect("trusts");
    other.forget();
    assert_eq!(other.run(&server.address()).ran, "");
    other.trusted().revoke(&first.key().public()).expect("revokes");
    other.forget();
    let ran = other.run(&server.address());
    assert_eq!((ran.ran.as_str(), ran.ids()), ("d e n w", vec!["remote-revoked"]));
}

/// Another user of the server stores false results under the right keys: unsigned, signed by a key of their own,
/// and results of one key under another key.
#[test]
fn a_lie_in_the_cache_is_not_used() {
    let Some(server) = Casd::start() else { return };
    let honest = Client::new(&[]).publishing();
    let ran = honest.run(&server.address());
    assert_eq!(ran.written.as_deref(), Some(WRITTEN));
    let engine = honest.engine();
    let keys = engine.store().record_keys().expect("keys");
    let entries: Vec<Entry> = keys.iter().filter_map(|key| Entry::stored(engine.store(), key)).collect();
    assert_eq!(entries.len(), 4);
    let liar = Client::new(&[]).publishing();
    let evil = liar.connect(&server.address()).expect("connects");
    let mut lies = 0;
    for (at, entry) in entries.iter().enumerate() {
        let next = &entries[(at + 1) % entries.len()];
        let signed_by_liar = seal(entry, &liar.key());
        let of_another_key = seal(next, &honest.key());
        for sealed in [b"no entry".to_vec(), entry.encode(), signed_by_liar, of_another_key] {
            evil.server().store(&entry.key, &sealed, &[], &false.into()).expect("the server takes it");
            lies += 1;
            let victim = Client::new(&[&honest]);
            let ran = victim.run(&server.address());
            assert_eq!(ran.written.as_deref(), Some(WRITTEN));
            assert_eq!(
                (ran.ids().len(), ran.ran.split(' ').count()),
                (1, 1),
                "{} {:?}",
                ran.ran,
                ran.warnings
            );
            assert!(ran.ids()[0].starts_with("remote-"), "{:?}", ran.warnings);
        }
        // The true entry, without its values.
        evil.server().store(&entry.key, &seal(entry, &honest.key()), &[], &false.into()).expect("stores");
        let ran = Client::new(&[&honest]).run(&server.address());
        assert_eq!((ran.written.as_deref(), ran.ids()), (Some(WRITTEN), vec!["remote-incomplete"]));
        // And again as it was.
        let values: Vec<_> = entry.blobs().expect("a record").into_iter().collect();
        let bytes: Vec<Vec<u8>> = values
            .iter()
            .map(|value| engine.store().get_blob(value).expect("reads").expect("the value"))
            .collect();
        let values: Vec<_> = values.iter().copied().zip(bytes.iter().map(Vec::as_slice)).collect();
        evil.server().store(&entry.key, &seal(entry, &honest.key()), &values, &false.into()).expect("stores");
    }
    assert_eq!(lies, 16);
    assert_eq!(Client::new(&[&honest]).run(&server.address()).ran, "");
}
