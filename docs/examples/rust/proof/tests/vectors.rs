// SPDX-License-Identifier: Apache-2.0
//! Every vector of schemas/vectors/proof.json, and what must not be believed.

use std::fs;

use cruiser_proof::{
    Id, Lease, Message, Operator, Outcome, Robot, authority_text, fingerprint, fits, is_ahead, public_key,
    request_text, run_of, signed_text, statement_id,
};
use ed25519_dalek::{Signer, SigningKey, VerifyingKey};
use serde_json::Value;
use x25519_dalek::{PublicKey, StaticSecret};

const RUN: Id = [1, 2, 3, 4, 5, 6, 7, 8];
const LEASE: u64 = 4711;

struct Vectors(Value);

impl Vectors {
    fn read() -> Self {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../schemas/vectors/proof.json");
        Self(serde_json::from_str(&fs::read_to_string(path).expect(path)).expect(path))
    }

    fn text(&self, part: &str, name: &str) -> &str {
        self.0[part][name].as_str().unwrap_or_else(|| panic!("{part} {name}"))
    }

    fn bytes(&self, part: &str, name: &str) -> Vec<u8> {
        hex::decode(self.text(part, name)).expect(name)
    }

    fn seed(&self, name: &str) -> [u8; 32] {
        self.bytes("keys", name).try_into().expect(name)
    }

    fn key(&self, name: &str) -> SigningKey {
        SigningKey::from_bytes(&self.seed(name))
    }

    fn authority(&self) -> VerifyingKey {
        self.key("authority").verifying_key()
    }

    fn operator(&self) -> Operator {
        Operator::new(self.key("ann"), self.text("statement", "text").into(), self.authority()).expect("ann")
    }

    /// The robot, met by a grant that the authority signs.
    fn robot(&self) -> Robot {
        Robot::of_chain(&self.own(self.key("authority"), "robot", "cruiser-1"), "cruiser-1", &self.authority(), 20)
            .expect("cruiser-1")
    }

    /// A grant of a robot from 10 to 30.
    fn own(&self, signer: SigningKey, role: &str, name: &str) -> String {
        let key = hex::encode(self.key("cruiser-1").verifying_key());
        let body = format!(
            r#"{{"kind":"grant","name":"{name}","key":"{key}","role":"{role}","not_before":10,"not_after":30}}"#
        );
        let signature = signer.sign(&signed_text(b'A', &[body.as_bytes()]));
        format!("{body}\ned25519 {} {}\n", hex::encode(signer.verifying_key()), hex::encode(signature.to_bytes()))
    }
}

/// The message of a part, with the payload that it borrows.
struct Sent<'a>(&'a str, &'a str, Vec<u8>);

impl<'a> Sent<'a> {
    fn of(vectors: &'a Vectors, part: &str) -> Self {
        Self(vectors.text(part, "key"), vectors.text(part, "encoding"), vectors.bytes(part, "payload"))
    }

    fn message(&self) -> Message<'_> {
        Message { key: self.0, encoding: self.1, payload: &self.2 }
    }
}

#[test]
fn a_statement_is_signed_by_the_authority() {
    let vectors = Vectors::read();
    let body = vectors.text("statement", "body");
    let text = signed_text(b'A', &[body.as_bytes()]);
    assert_eq!(text, vectors.bytes("statement", "signed"));
    assert!(fits(&vectors.authority(), &vectors.bytes("statement", "signature"), &text));
    assert_eq!(statement_id(body).as_slice(), vectors.bytes("statement", "id"));
    let (authority, signature) = (hex::encode(vectors.authority()), vectors.text("statement", "signature"));
    assert_eq!(vectors.text("statement", "text"), format!("{body}\ned25519 {authority} {signature}\n"));
    assert_eq!(vectors.operator().name, "ann");
}

#[test]
fn a_request_has_the_same_bytes() {
    let vectors = Vectors::read();
    let sent = Sent::of(&vectors, "request");
    let attachment = vectors.operator().attach(&sent.message(), b"challeng", b"nonce-01");
    assert_eq!(sent.message().text(b'S', &attachment[..25], None), vectors.bytes("request", "signed"));
    assert_eq!(attachment, vectors.bytes("request", "attachment"));
}

#[test]
fn a_reply_is_of_the_robot_and_to_this_request() {
    let vectors = Vectors::read();
    let (sent, attachment) = (Sent::of(&vectors, "reply"), vectors.bytes("reply", "attachment"));
    let (message, request) = (sent.message(), vectors.bytes("request", "attachment"));
    let robot = vectors.robot();
    assert_eq!(message.text(b'R', &attachment[..9], Some(&request)), vectors.bytes("reply", "signed"));
    assert!(robot.is_reply(&message, &attachment, &request));
    assert_eq!(run_of(&attachment).expect("run"), RUN);
    assert!(!robot.is_reply(&message, &attachment, b""), "it replies to another request");
    assert!(!robot.is_publication(&message, &attachment, &RUN), "it is a reply");
    assert!(!robot.is_reply(&Message { payload: b"", ..message }, &attachment, &request), "another payload");
    for at in 0..attachment.len() {
        let mut other = attachment.clone();
        other[at] ^= 1;
        assert!(!robot.is_reply(&message, &other, &request), "byte {at} is another");
        assert!(!robot.is_reply(&message, &attachment[..at], &request), "it has {at} bytes");
    }
}

#[test]
fn a_drive_command_is_proven_by_the_lease() {
    let vectors = Vectors::read();
    let sent = Sent::of(&vectors, "drive");
    let ours = StaticSecret::from(vectors.seed("lease of ann"));
    let robots = PublicKey::from(&StaticSecret::from(vectors.seed("lease of robot")));
    let lease = Lease::agree(ours.clone(), robots.as_bytes(), &RUN, LEASE, sent.0).expect("lease");
    assert_eq!(lease.attach(&sent.message()), vectors.bytes("drive", "attachment"));
    let known = Lease::with_key(LEASE, &vectors.bytes("drive", "lease_key")).expect("key");
    assert_eq!(known.attach(&sent.message()), vectors.bytes("drive", "attachment"));
    assert!(Lease::agree(ours.clone(), &[0; 32], &RUN, LEASE, sent.0).is_err(), "a key of small order");
    assert!(Lease::agree(ours, &[7; 31], &RUN, LEASE, sent.0).is_err(), "a key that is too short");
}

#[test]
fn a_verb_of_the_leases_holder_has_a_tag() {
    let vectors = Vectors::read();
    let (sent, attachment) = (Sent::of(&vectors, "verb"), vectors.bytes("verb", "attachment"));
    let lease = Lease::with_key(LEASE, &vectors.bytes("drive", "lease_key")).expect("key");
    assert_eq!(lease.tag(&sent.message(), &attachment[..89]), attachment);
}

#[test]
fn a_state_is_of_the_robot() {
    let vectors = Vectors::read();
    let (sent, attachment) = (Sent::of(&vectors, "publication"), vectors.bytes("publication", "attachment"));
    assert_eq!(sent.message().text(b'P', &attachment[..9], None), vectors.bytes("publication", "signed"));
    assert!(vectors.robot().is_publication(&sent.message(), &attachment, &RUN));
    assert!(!vectors.robot().is_publication(&sent.message(), &attachment, &[0; 8]), "another run");
    let elsewhere = Message { key: "fleet/cruiser-2/safety/state", ..sent.message() };
    assert!(!vectors.robot().is_publication(&elsewhere, &attachment, &RUN), "another robot");
}

#[test]
fn a_sequence_rises_and_begins_again() {
    let ahead = [(0, None), (8, Some(7)), (0, Some(u32::MAX)), ((1 << 31) - 1, Some(0))];
    let behind = [(7, Some(7)), (6, Some(7)), (u32::MAX, Some(0)), (1 << 31, Some(0))];
    assert!(ahead.iter().all(|&(sequence, newest)| is_ahead(sequence, newest)));
    assert!(!behind.iter().any(|&(sequence, newest)| is_ahead(sequence, newest)));
}

#[test]
fn a_robot_is_believed_by_the_authority_alone() {
    let vectors = Vectors::read();
    let met = |own: &str, now_s: u64| -> Outcome<Robot> {
        Robot::of_chain(own, "cruiser-1", &vectors.authority(), now_s)
    };
    let good = vectors.own(vectors.key("authority"), "robot", "cruiser-1");
    assert!(met(&good, 10).is_ok() && met(&good, 30).is_ok());
    assert!(met(&good, 9).is_err() && met(&good, 31).is_err(), "over, or not begun");
    assert!(met(&good.replace("\"not_after\":30", "\"not_after\":31"), 20).is_err(), "another text");
    assert!(met(&vectors.own(vectors.key("authority"), "operator", "cruiser-1"), 20).is_err(), "no robot");
    assert!(met(&vectors.own(vectors.key("authority"), "robot", "cruiser-2"), 20).is_err(), "another robot");
    assert!(met(&vectors.own(vectors.key("ann"), "robot", "cruiser-1"), 20).is_err(), "another authority");
    assert!(met("", 20).is_err() && met(&format!("{good}{good}"), 20).is_err(), "not one statement");
    let stolen = good.replace(&hex::encode(vectors.authority()), &hex::encode(vectors.key("ann").verifying_key()));
    assert!(met(&stolen, 20).is_err(), "another signer");
    assert!(public_key("zz").is_err());
}

#[test]
fn what_people_compare_has_the_same_text() {
    let vectors = Vectors::read();
    let request = &vectors.0["enrolment"]["request"];
    let key = vectors.key("ann").verifying_key();
    let text = request_text("operator", &["ann"], key.as_bytes(), "");
    assert_eq!(text, vectors.bytes("enrolment", "signed"));
    assert!(fits(&key, &hex::decode(request["proof"].as_str().expect("proof")).expect("proof"), &text));
    assert_eq!(fingerprint(&text), vectors.text("enrolment", "fingerprint"));
    let certified = request_text("operator", &["one.example", "10.0.0.5"], b"", "csr");
    assert_eq!(certified, vectors.bytes("enrolment", "signed_with_csr"));
    let standby = vectors.0["bundle"]["text"].as_str().and_then(|text| text.split("standby\":\"").nth(1)).expect("standby");
    let standby = hex::decode(&standby[..64]).expect("standby");
    let routers = ["tls/router.example:7447", "quic/10.0.0.5:7447"];
    let shown = fingerprint(&authority_text(vectors.authority().as_bytes(), &standby, "ca", "fleet", &routers));
    assert_eq!(shown, vectors.text("bundle", "fingerprint"));
}

#[test]
fn a_grant_for_another_key_is_not_used() {
    let vectors = Vectors::read();
    let text = vectors.text("statement", "text");
    assert!(Operator::new(vectors.key("cruiser-1"), text.into(), vectors.authority()).is_err());
}
