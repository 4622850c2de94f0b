// SPDX-License-Identifier: Apache-2.0
//! Proof of commands to a robot in signed mode, and of what it says. Written from docs/authority.md alone.
//!
//! No input and output but [`Operator::read`], and no randomness: nonces and keys of leases are arguments.
//! `cargo test` holds it against schemas/vectors/proof.json.

use std::error::Error;
use std::fs;
use std::path::Path;

use ed25519_dalek::pkcs8::DecodePrivateKey;
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use hkdf::Hkdf;
use hmac::{Hmac, KeyInit, Mac};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use x25519_dalek::{PublicKey, StaticSecret};

pub type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Identifier of a grant, challenge, nonce, or run of a gateway.
pub type Id = [u8; 8];

const VERSION: u8 = 1;
const SIGNATURE_BYTES: usize = 64;
const ROBOT_FIELDS_BYTES: usize = 1 + 8; // of a reply's attachment, before the signature

/// The text that is signed. No two lists of parts give the same.
pub fn signed_text(kind: u8, parts: &[&[u8]]) -> Vec<u8> {
    let mut text = b"cruiser-auth-1\0".to_vec();
    text.push(kind);
    for part in parts {
        text.extend((part.len() as u32).to_be_bytes());
        text.extend(*part);
    }
    text
}

/// What is sent, and under which names. The encoding is the one that docs/commands.md gives, whatever Zenoh carried.
#[derive(Clone, Copy)]
pub struct Message<'a> {
    pub key: &'a str,
    pub encoding: &'a str,
    pub payload: &'a [u8],
}

impl Message<'_> {
    /// The text under its proof; `fields` is its attachment up to there.
    pub fn text(&self, kind: u8, fields: &[u8], request: Option<&[u8]>) -> Vec<u8> {
        let mut parts = vec![self.key.as_bytes(), self.encoding.as_bytes(), fields, self.payload];
        parts.extend(request);
        signed_text(kind, &parts)
    }
}

/// What a grant says, as far as a client needs it.
#[derive(Deserialize)]
struct Grant {
    kind: String,
    name: String,
    key: String,
    role: String,
    not_before: u64,
    not_after: u64,
}

/// A key that signs verbs, the grant that makes robots obey it, and the authority that robots are known by.
pub struct Operator {
    /// The operator's chunk in the keys of its commands.
    pub name: String,
    /// The text of its grant with its chain, to be shown to robots.
    pub statement: String,
    pub authority: VerifyingKey,
    key: SigningKey,
    grant: Id,
}

impl Operator {
    pub fn new(key: SigningKey, statement: String, authority: VerifyingKey) -> Outcome<Self> {
        let body = statement.lines().next().unwrap_or_default();
        let grant: Grant = serde_json::from_str(body)?;
        if grant.key != hex::encode(key.verifying_key().as_bytes()) {
            return Err("the grant is for another key".into());
        }
        Ok(Self { name: grant.name, grant: statement_id(body), statement, authority, key })
    }

    /// The operator whose files `cruiser provision` left in this directory.
    pub fn read(directory: &Path) -> Outcome<Self> {
        #[derive(Deserialize)]
        struct Authority {
            active: String,
        }
        let text = |name: &str| {
            let path = directory.join(name);
            fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))
        };
        let authority: Authority = serde_json::from_str(&text("authority.json")?)?;
        let key = SigningKey::from_pkcs8_pem(&text("operator.key")?)?;
        Self::new(key, text("operator.grant")?, public_key(&authority.active)?)
    }

    /// The attachment of a verb, 89 bytes.
    ///
    /// `challenge` is the newest one of `safety/state`; the nonce is random, and new in each request.
    pub fn attach(&self, message: &Message, challenge: &Id, nonce: &Id) -> Vec<u8> {
        let mut attachment = vec![VERSION];
        attachment.extend([self.grant, *challenge, *nonce].concat());
        let signature = self.key.sign(&message.text(b'S', &attachment, None));
        attachment.extend(signature.to_bytes());
        attachment
    }
}

/// The key of a robot that was met: what it says is checked with it.
pub struct Robot(VerifyingKey);

impl Robot {
    /// The robot that proves by the chain of its own grant (`own` of its reply) that it has this name.
    ///
    /// The authority alone grants a robot, so that its chain is one statement.
    pub fn of_chain(own: &str, name: &str, authority: &VerifyingKey, now_s: u64) -> Outcome<Self> {
        let lines: Vec<&str> = own.lines().collect();
        let &[body, proof] = lines.as_slice() else {
            return Err("the robot's grant is not one statement of the authority".into());
        };
        let words: Vec<&str> = proof.split(' ').collect();
        let &["ed25519", signer, signature] = words.as_slice() else {
            return Err("the robot's grant has no signature".into());
        };
        if public_key(signer)? != *authority {
            return Err("the robot's grant is of another authority".into());
        }
        let text = signed_text(b'A', &[body.as_bytes()]);
        if !fits(authority, &hex::decode(signature)?, &text) {
            return Err("the signature of the robot's grant does not fit".into());
        }
        let grant: Grant = serde_json::from_str(body)?;
        if grant.kind != "grant" || grant.role != "robot" || grant.name != name {
            return Err(format!("the grant is of {} {}, not of robot {name}", grant.role, grant.name).into());
        }
        if !(grant.not_before..=grant.not_after).contains(&now_s) {
            return Err("the robot's grant has expired or is not valid yet".into());
        }
        Ok(Self(public_key(&grant.key)?))
    }

    /// Is it the robot's reply to the request that had this attachment?
    pub fn is_reply(&self, message: &Message, attachment: &[u8], request: &[u8]) -> bool {
        self.has_signed(message, b'R', attachment, Some(request))
    }

    /// Did the robot publish it in this run, the one of its reply on `@auth`?
    ///
    /// A sample of this run may still be an old one: see [`is_ahead`].
    pub fn is_publication(&self, message: &Message, attachment: &[u8], run: &Id) -> bool {
        run_of(attachment).is_ok_and(|of| of == *run) && self.has_signed(message, b'P', attachment, None)
    }

    fn has_signed(&self, message: &Message, kind: u8, attachment: &[u8], request: Option<&[u8]>) -> bool {
        if attachment.len() != ROBOT_FIELDS_BYTES + SIGNATURE_BYTES || attachment[0] != VERSION {
            return false;
        }
        let (fields, signature) = attachment.split_at(ROBOT_FIELDS_BYTES);
        fits(&self.0, signature, &message.text(kind, fields, request))
    }
}

/// Is this `sequence` after the newest one that was believed? After the last number, 0 follows.
pub fn is_ahead(sequence: u32, newest: Option<u32>) -> bool {
    newest.is_none_or(|newest| (1..1 << 31).contains(&sequence.wrapping_sub(newest)))
}

/// The run of the gateway that made a reply or a sample, from its attachment.
pub fn run_of(attachment: &[u8]) -> Outcome<Id> {
    Ok(attachment.get(1..ROBOT_FIELDS_BYTES).ok_or("the attachment has no run")?.try_into()?)
}

/// A lease: its number, and the key that its holder and the robot alone know.
#[derive(Clone)]
pub struct Lease {
    number: u64,
    mac: Hmac<Sha256>,
}

impl Lease {
    /// The lease of a verified reply to `acquire` or `take`.
    ///
    /// `private` is the key whose public half was in the request, `public` the reply's `public_key`, `drive_key` the
    /// key expression of the drive commands.
    pub fn agree(private: StaticSecret, public: &[u8], run: &Id, number: u64, drive_key: &str) -> Outcome<Self> {
        let other = PublicKey::from(<[u8; 32]>::try_from(public)?);
        let ours = PublicKey::from(&private);
        let shared = private.diffie_hellman(&other);
        if !shared.was_contributory() {
            return Err("the robot's public key is none".into());
        }
        let salt = signed_text(b'L', &[run, &number.to_be_bytes(), drive_key.as_bytes()]);
        let (lower, higher) = if ours.as_bytes() < other.as_bytes() { (&ours, &other) } else { (&other, &ours) };
        let info = signed_text(b'L', &[lower.as_bytes(), higher.as_bytes()]);
        let mut key = [0; 32];
        let derived = Hkdf::<Sha256>::new(Some(&salt), shared.as_bytes()).expand(&info, &mut key);
        derived.map_err(|error| error.to_string())?;
        Self::with_key(number, &key)
    }

    /// The lease of this number under this key, 32 bytes.
    pub fn with_key(number: u64, key: &[u8]) -> Outcome<Self> {
        Ok(Self { number, mac: Hmac::new_from_slice(key)? })
    }

    /// The attachment of a drive command, 25 bytes.
    pub fn attach(&self, message: &Message) -> Vec<u8> {
        let mut attachment = vec![VERSION];
        attachment.extend(self.number.to_be_bytes());
        let tag = self.mac.clone().chain_update(message.text(b'M', &attachment, None)).finalize().into_bytes();
        attachment.extend(&tag[..16]);
        attachment
    }

    /// The attachment of a verb of the lease's holder, 105 bytes, from the signed one: no flood keeps it waiting.
    pub fn tag(&self, message: &Message, signed: &[u8]) -> Vec<u8> {
        let fields = &signed[..signed.len() - SIGNATURE_BYTES];
        let tag = self.mac.clone().chain_update(message.text(b'S', fields, None)).finalize().into_bytes();
        [signed, &tag[..16]].concat()
    }
}

/// The identifier of a statement, from its JSON.
pub fn statement_id(body: &str) -> Id {
    let mut id = Id::default();
    id.copy_from_slice(&Sha256::digest(body)[..8]);
    id
}

/// A public key that is written in hexadecimal.
pub fn public_key(text: &str) -> Outcome<VerifyingKey> {
    Ok(VerifyingKey::try_from(hex::decode(text)?.as_slice())?)
}

/// Is it the signature of this key over this text?
pub fn fits(key: &VerifyingKey, signature: &[u8], text: &[u8]) -> bool {
    Signature::from_slice(signature).is_ok_and(|signature| key.verify_strict(text, &signature).is_ok())
}

/// The text of a request to be let in: what its keys sign, and of which its fingerprint is.
pub fn request_text(role: &str, names: &[&str], key: &[u8], csr: &str) -> Vec<u8> {
    let mut parts = vec![b"request-2".as_slice(), role.as_bytes(), key, csr.as_bytes()];
    parts.extend(names.iter().map(|name| name.as_bytes()));
    signed_text(b'A', &parts)
}

/// The text of which the fingerprint of an authority is: both its keys, the network's authority, and where the fleet is.
pub fn authority_text(active: &[u8], standby: &[u8], ca: &str, root: &str, routers: &[&str]) -> Vec<u8> {
    let mut parts = vec![b"authority".as_slice(), active, standby, ca.as_bytes(), root.as_bytes()];
    parts.extend(routers.iter().map(|router| router.as_bytes()));
    signed_text(b'A', &parts)
}

/// What people compare by voice: the first half of a SHA-256, in groups.
pub fn fingerprint(text: &[u8]) -> String {
    let digest = Sha256::digest(text);
    digest[..16].chunks(2).map(hex::encode).collect::<Vec<_>>().join("-")
}
