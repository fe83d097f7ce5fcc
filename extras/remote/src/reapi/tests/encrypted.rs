//! Encrypted connections: certificates of the server and of the client, and tokens.

use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};
use tonic::transport::{Certificate, Identity, ServerTlsConfig};

use super::client::{Client, WRITTEN};
use super::fake::{Fake, Script};
use crate::credentials::Credentials;

const TOKEN: &str = "token-of-the-test";

/// An authority that signs certificates.
struct Authority {
    pem: String,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    fn new() -> Self {
        let key = KeyPair::generate().expect("a key");
        let mut params = CertificateParams::new(Vec::new()).expect("parameters");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let pem = params.self_signed(&key).expect("a certificate").pem();
        Self { pem, issuer: Issuer::new(params, key) }
    }

    /// A certificate for a name, and its private key.
    fn signs(&self, name: &str) -> [String; 2] {
        let key = KeyPair::generate().expect("a key");
        let params = CertificateParams::new(vec![name.to_owned()]).expect("parameters");
        let certificate = params.signed_by(&key, &self.issuer).expect("a certificate");
        [certificate.pem(), key.serialize_pem()]
    }
}

/// Starts a server for `name` whose clients need the token, and a certificate if there is an authority for clients.
fn server(authority: &Authority, name: &str, of_clients: Option<&Authority>) -> Fake {
    let [certificate, key] = authority.signs(name);
    let tls = ServerTlsConfig::new().identity(Identity::from_pem(certificate, key));
    let tls = match of_clients {
        Some(authority) => tls.client_ca_root(Certificate::from_pem(&authority.pem)),
        None => tls,
    };
    let script = Script { functions: vec![1], updates: true, ..Script::default() };
    Fake::encrypted(script, tls, TOKEN)
}

fn credentials(authority: Option<&Authority>, token: Option<&str>) -> Credentials {
    Credentials {
        authorities: authority.map(|authority| authority.pem.clone()),
        identity: None,
        token: token.map(str::to_owned),
    }
}

#[test]
fn results_are_shared_over_an_encrypted_connection() {
    let authority = Authority::new();
    let fake = server(&authority, "127.0.0.1", Some(&authority));
    let mut first = Client::new(&[]).publishing();
    first.credentials =
        Credentials { identity: Some(authority.signs("me")), ..credentials(Some(&authority), Some(TOKEN)) };
    let ran = first.run(&fake.address);
    assert_eq!((ran.written.as_deref(), ran.traffic.stored), (Some(WRITTEN), 4), "{:?}", ran.warnings);
    let mut second = Client::new(&[&first]);
    second.credentials = first.credentials;
    let ran = second.run(&fake.address);
    assert_eq!((ran.ran.as_str(), ran.written.as_deref()), ("", Some(WRITTEN)));
}

/// A server that cannot prove its name, a client that cannot prove its own, and a wrong token end the connection
/// before anything but the token is sent.
#[test]
fn who_cannot_prove_who_they_are_is_refused() {
    let (authority, other) = (Authority::new(), Authority::new());
    let refused = |fake: &Fake, credentials: Credentials, says: &str| {
        let mut client = Client::new(&[]);
        client.credentials = credentials;
        client.retry.attempts = 1;
        let error = client.connect(&fake.address).err().map(|e| e.to_string()).unwrap_or_default();
        assert!(error.contains(says), "{error}");
        assert_eq!(fake.script().calls.len(), 0, "{:?}", fake.script().calls);
    };
    let right = || credentials(Some(&authority), Some(TOKEN));
    let fake = server(&authority, "127.0.0.1", None);
    refused(&fake, credentials(Some(&other), Some(TOKEN)), "failed");
    // The operating system does not know the authority.
    refused(&fake, credentials(None, Some(TOKEN)), "failed");
    refused(&fake, credentials(Some(&authority), None), "a wrong token");
    refused(&fake, credentials(Some(&authority), Some("other")), "a wrong token");
    refused(&server(&authority, "another.host", None), right(), "failed");
    refused(&server(&authority, "127.0.0.1", Some(&other)), right(), "failed");
    let identity = Some(authority.signs("me"));
    refused(&server(&authority, "127.0.0.1", Some(&other)), Credentials { identity, ..right() }, "failed");
}

#[test]
fn a_token_is_not_sent_in_the_clear() {
    let mut client = Client::new(&[]);
    client.credentials = credentials(None, Some(TOKEN));
    let error = client.connect("grpc://example.org:1").err().map(|e| e.to_string()).unwrap_or_default();
    assert!(error.contains("only sent over an encrypted connection"), "{error}");
    assert!(!error.contains(TOKEN), "{error}");
}
