//! Proofs of origin, by docs/proofs.md alone: what a member of a fleet with credentials signs, seals and believes.
//!
//! `cargo test` holds it to docs/proof-vectors.json.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use base64::{engine::general_purpose::STANDARD, Engine};
use blake2::{digest::consts::U16, digest::Mac, Blake2sMac};
use ed25519_dalek::{pkcs8::DecodePrivateKey, Signature, Signer, SigningKey, VerifyingKey};
use hkdf::Hkdf;
use rand_core::{OsRng, RngCore};
use serde_json::Value;
use sha2::{Digest, Sha256};
use x25519_dalek::{PublicKey, StaticSecret};
use x509_parser::prelude::{parse_x509_pem, AttributeTypeAndValue, FromDer, X509Certificate};

/// Contexts: of what somebody says, and of what somebody answers.
pub const TOLD: &[u8] = b"zmav proof of origin 1";
pub const ANSWERED: &[u8] = b"zmav proof of an answer 1";
const INTRODUCED: u8 = 1;
const TAGGED: u8 = 2;
const HEAD: usize = 34;
const UNINTRODUCED: usize = 98;
const TAG: usize = 16;
const MOST: usize = 2048;

pub type Eight = [u8; 8];

/// Eight random bytes: a nonce, or the challenge of a question.
pub fn random() -> Eight {
    let mut found = [0; 8];
    OsRng.fill_bytes(&mut found);
    found
}

/// Eight bytes from 16 hexadecimal digits; `None` for any other value.
pub fn eight(value: &Value) -> Option<Eight> {
    unhex(value.as_str()?)?.try_into().ok()
}

pub fn unhex(text: &str) -> Option<Vec<u8>> {
    if !text.is_ascii() || text.len() % 2 != 0 {
        return None;
    }
    let pairs = (0..text.len()).step_by(2);
    pairs.map(|at| u8::from_str_radix(&text[at..at + 2], 16).ok()).collect()
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Who a member is, by a certificate.
#[derive(Clone)]
pub struct Certificate {
    pub der: Vec<u8>,
    pub name: String,
    pub fleet: String,
    pub role: String,
    pub key: VerifyingKey,
    pub fingerprint: Eight,
    valid: (i64, i64),
    signed: Vec<u8>,
    signature: Vec<u8>,
}

impl Certificate {
    pub fn read(der: &[u8]) -> Result<Self, String> {
        let (rest, found) = X509Certificate::from_der(der).map_err(|e| e.to_string())?;
        if !rest.is_empty() {
            return Err("bytes behind a certificate".to_owned());
        }
        let key: [u8; 32] =
            found.public_key().subject_public_key.data.as_ref().try_into().map_err(|_| "no Ed25519 key")?;
        let subject = found.subject();
        Ok(Self {
            der: der.to_vec(),
            name: one(subject.iter_common_name())?,
            fleet: one(subject.iter_organization()).unwrap_or_default(), // the authority has neither
            role: one(subject.iter_organizational_unit()).unwrap_or_default(),
            key: VerifyingKey::from_bytes(&key).map_err(|e| e.to_string())?,
            fingerprint: Sha256::digest(der)[..8].try_into().expect("eight bytes"),
            valid: (found.validity().not_before.timestamp(), found.validity().not_after.timestamp()),
            signed: found.tbs_certificate.as_ref().to_vec(),
            signature: found.signature_value.data.to_vec(),
        })
    }

    fn from_pem(file: &Path) -> Result<Self, String> {
        let text = fs::read(file).map_err(|e| format!("{}: {e}", file.display()))?;
        let (_, pem) = parse_x509_pem(&text).map_err(|e| format!("{}: {e}", file.display()))?;
        Self::read(&pem.contents)
    }
}

/// The only one of its kind in a subject.
fn one<'s, 'a: 's>(mut found: impl Iterator<Item = &'s AttributeTypeAndValue<'a>>) -> Result<String, String> {
    match (found.next(), found.next()) {
        (Some(name), None) => name.as_str().map(str::to_owned).map_err(|e| e.to_string()),
        _ => Err("a certificate whose subject has not one of each name".to_owned()),
    }
}

/// What is signed beside the signature itself.
fn message(context: &[u8], head: &[u8], key: &str, payload: &[u8]) -> Vec<u8> {
    [context, &(key.len() as u16).to_be_bytes(), key.as_bytes(), head, payload].concat()
}

/// What a proof says beside who signed what.
pub struct Said {
    pub micros: u64,
    pub nonce: Eight,
    pub answers: Eight,
}

/// The attachment of `payload` on `key`. `to`: for whom it bears a tag. `introduce`: the certificate follows.
pub fn sign(
    by: &SigningKey,
    certificate: &Certificate,
    context: &[u8],
    (key, payload): (&str, &[u8]),
    said: &Said,
    introduce: bool,
    to: Option<&Certificate>,
) -> Vec<u8> {
    let flags = u8::from(introduce) * INTRODUCED | u8::from(to.is_some()) * TAGGED;
    let mut made = vec![1, flags];
    made.extend(said.micros.to_be_bytes());
    made.extend(said.nonce);
    made.extend(certificate.fingerprint);
    made.extend(said.answers);
    let mut spoken = message(context, &made, key, payload);
    let signature = by.sign(&spoken).to_bytes();
    made.extend(signature);
    spoken.extend(signature);
    if let Some(to) = to {
        let shared = StaticSecret::from(by.to_scalar_bytes())
            .diffie_hellman(&PublicKey::from(to.key.to_montgomery().to_bytes()));
        let mut both = [certificate.fingerprint, to.fingerprint];
        both.sort();
        let secret = derive(shared.as_bytes(), &[b"zmav tags 1".as_slice(), &both.concat()].concat());
        made.extend(mac(&secret, &[certificate.fingerprint.as_slice(), &spoken].concat()));
    }
    if introduce {
        made.extend(&certificate.der);
    }
    made
}

fn derive(shared: &[u8], info: &[u8]) -> [u8; 32] {
    let mut secret = [0; 32];
    Hkdf::<Sha256>::new(None, shared).expand(info, &mut secret).expect("32 bytes are few");
    secret
}

fn mac(secret: &[u8; 32], message: &[u8]) -> [u8; TAG] {
    let mut made = Blake2sMac::<U16>::new_from_slice(secret).expect("32 bytes are a key");
    made.update(message);
    made.finalize().into_bytes().into()
}

/// Seals the setpoints of one lease.
pub struct Seal {
    pub secret: [u8; 32],
}

impl Seal {
    /// `ours` was made for this lease, `theirs` is in its answer; `place` is `FLEET/VEHICLE`.
    pub fn new(ours: &StaticSecret, theirs: &str, place: &str, lease: &str) -> Option<Self> {
        let theirs: [u8; 32] = unhex(theirs)?.try_into().ok()?;
        let shared = ours.diffie_hellman(&PublicKey::from(theirs));
        let info = [b"zmav setpoints 1".as_slice(), place.as_bytes(), lease.as_bytes()].join(&0);
        Some(Self { secret: derive(shared.as_bytes(), &info) })
    }

    pub fn of(&self, key: &str, payload: &[u8]) -> Vec<u8> {
        let sealed = [&(key.len() as u16).to_be_bytes(), key.as_bytes(), payload].concat();
        [[2].as_slice(), &mac(&self.secret, &sealed)].concat()
    }
}

/// A new key for the setpoints of one lease.
pub fn lease_key() -> StaticSecret {
    StaticSecret::random_from_rng(OsRng)
}

/// The roster's JSON, where the authority signed it.
pub fn open_roster(signed: &Value, authority: &VerifyingKey) -> Result<Value, String> {
    let text = signed["roster"].as_str().ok_or("a roster without its text")?;
    let signature = STANDARD.decode(signed["signature"].as_str().unwrap_or_default()).map_err(|e| e.to_string())?;
    check(authority, text.as_bytes(), &signature)?;
    serde_json::from_str(text).map_err(|e| e.to_string())
}

fn check(key: &VerifyingKey, message: &[u8], signature: &[u8]) -> Result<(), String> {
    let signature = Signature::from_slice(signature).map_err(|e| e.to_string())?;
    key.verify_strict(message, &signature).map_err(|_| "a wrong signature".to_owned())
}

/// A member's folder: it signs, and believes of a vehicle what that signed.
pub struct Member {
    certificate: Certificate,
    key: SigningKey,
    authority: VerifyingKey,
    revoked: HashSet<String>,
    known: HashMap<Eight, Certificate>,
    last: u64,
}

impl Member {
    pub fn load(folder: &Path) -> Result<Self, String> {
        let text = |name: &str| {
            fs::read_to_string(folder.join(name)).map_err(|e| format!("{}: {e}", folder.join(name).display()))
        };
        let authority = Certificate::from_pem(&folder.join("ca.pem"))?.key;
        let signed = serde_json::from_str(&text("roster.json")?).map_err(|e| format!("roster.json: {e}"))?;
        let roster = open_roster(&signed, &authority)?;
        let revoked = roster["revoked"].as_array().into_iter().flatten();
        let revoked = revoked.filter_map(|each| each.as_str().map(str::to_owned)).collect();
        let certificate = Certificate::from_pem(&folder.join("cert.pem"))?;
        if roster["fleet"].as_str() != Some(&certificate.fleet) {
            return Err(format!("{}: a roster of another fleet", folder.display()));
        }
        let key = SigningKey::from_pkcs8_pem(&text("key.pem")?).map_err(|e| format!("key.pem: {e}"))?;
        Ok(Self { certificate, key, authority, revoked, known: HashMap::new(), last: 0 })
    }

    /// The proof of an order, for who has said that `gate`.
    pub fn prove(&mut self, key: &str, payload: &[u8], gate: Eight) -> Vec<u8> {
        self.last = micros().max(self.last + 1);
        let said = Said { micros: self.last, nonce: random(), answers: gate };
        sign(&self.key, &self.certificate, TOLD, (key, payload), &said, true, None)
    }

    /// Whether `vehicle` gave that answer to the question with this attachment: a proof, or a challenge alone.
    pub fn believe(
        &mut self,
        vehicle: &str,
        key: &str,
        payload: &[u8],
        proof: &[u8],
        question: &[u8],
    ) -> Result<(), String> {
        if !(UNINTRODUCED..=MOST).contains(&proof.len()) || proof[0] != 1 || proof[1] & !(INTRODUCED | TAGGED) != 0 {
            return Err("no proof of origin".to_owned());
        }
        let behind = UNINTRODUCED + if proof[1] & TAGGED != 0 { TAG } else { 0 };
        if proof.len() < behind || (proof[1] & INTRODUCED != 0) != (proof.len() > behind) {
            return Err("a proof of another length than its flags say".to_owned());
        }
        let challenge = if question.len() == 8 { question } else { &question[10..18] };
        if proof[26..HEAD] != *challenge {
            return Err("an answer to another question".to_owned());
        }
        let by = self.signer(&proof[18..26], &proof[behind..])?;
        if by.role != "vehicle" || by.name != vehicle {
            return Err(format!("{} ({}) answered in the place of {vehicle}", by.name, by.role));
        }
        check(&by.key, &message(ANSWERED, &proof[..HEAD], key, payload), &proof[HEAD..UNINTRODUCED])
    }

    /// The certificate with that fingerprint, from now on known where it came along.
    fn signer(&mut self, fingerprint: &[u8], der: &[u8]) -> Result<Certificate, String> {
        let name: Eight = fingerprint.try_into().map_err(|_| "no fingerprint")?;
        if self.revoked.contains(&hex(&name)) {
            return Err("it was turned out of the fleet".to_owned());
        }
        if let Some(known) = self.known.get(&name) {
            return Ok(known.clone());
        }
        let found = Certificate::read(der)?;
        let now = (micros() / 1_000_000) as i64;
        check(&self.authority, &found.signed, &found.signature)?;
        if found.fingerprint != name || found.fleet != self.certificate.fleet {
            return Err("a certificate of somebody else".to_owned());
        }
        if now < found.valid.0 || now > found.valid.1 {
            return Err("a certificate that is not valid now".to_owned());
        }
        self.known.insert(name, found.clone());
        Ok(found)
    }
}

/// UTC.
fn micros() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.expect("a clock after 1970").as_micros() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vectors() -> Value {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/proof-vectors.json");
        serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap()
    }

    fn bytes(value: &Value) -> Vec<u8> {
        unhex(value.as_str().unwrap()).unwrap()
    }

    fn secret(value: &Value) -> [u8; 32] {
        bytes(value).try_into().unwrap()
    }

    fn certificate(vectors: &Value, name: &str) -> Certificate {
        Certificate::read(&bytes(&vectors["members"][name]["certificate"])).unwrap()
    }

    #[test]
    fn proofs_are_the_same_bytes() {
        let vectors = vectors();
        for each in vectors["proofs"].as_array().unwrap() {
            let by = each["by"].as_str().unwrap();
            let key = SigningKey::from_bytes(&secret(&vectors["members"][by]["seed"]));
            let said = Said {
                micros: each["micros"].as_u64().unwrap(),
                nonce: eight(&each["nonce"]).unwrap(),
                answers: eight(&each["answers"]).unwrap_or_default(),
            };
            let context = if each["answer"] == true { ANSWERED } else { TOLD };
            let what = (each["key"].as_str().unwrap(), each["payload"].as_str().unwrap().as_bytes());
            let to = each["to"].as_str().map(|name| certificate(&vectors, name));
            let own = certificate(&vectors, by);
            let made = sign(&key, &own, context, what, &said, each["introduce"] == true, to.as_ref());
            assert_eq!(hex(&made), each["attachment"].as_str().unwrap(), "{}", each["what"]);
        }
    }

    #[test]
    fn members_are_signed_by_the_authority_and_on_its_roster() {
        let vectors = vectors();
        let authority = certificate(&vectors, "authority").key;
        let roster = open_roster(&vectors["roster"], &authority).unwrap();
        for member in roster["members"].as_array().unwrap() {
            let found = certificate(&vectors, member["name"].as_str().unwrap());
            check(&authority, &found.signed, &found.signature).unwrap();
            assert_eq!(hex(&found.fingerprint), member["fingerprint"].as_str().unwrap());
            assert_eq!(found.role, member["role"].as_str().unwrap());
            assert_eq!(found.fleet, roster["fleet"].as_str().unwrap());
        }
        let mut forged = vectors["roster"].clone();
        forged["roster"] = Value::from(forged["roster"].as_str().unwrap().replace("\"number\": 3", "\"number\": 4"));
        assert!(open_roster(&forged, &authority).is_err());
    }

    #[test]
    fn seals_are_the_same_bytes() {
        for each in vectors()["seals"].as_array().unwrap() {
            let ours = StaticSecret::from(secret(&each["holder_private"]));
            let text = |name: &str| each[name].as_str().unwrap();
            assert_eq!(hex(PublicKey::from(&ours).as_bytes()), text("holder_public"));
            let seal = Seal::new(&ours, text("vehicle_public"), text("place"), text("lease")).unwrap();
            assert_eq!(hex(&seal.secret), text("secret"));
            assert_eq!(hex(&seal.of(text("key"), text("payload").as_bytes())), text("attachment"));
        }
    }

    /// As alice, who asked with the order's nonce: the vehicle's answer is believed, and nothing else is.
    #[test]
    fn an_answer_is_believed_of_the_vehicle_alone() {
        let vectors = vectors();
        let answer = &vectors["proofs"].as_array().unwrap().iter().find(|each| each["answer"] == true).unwrap().clone();
        let question = bytes(&vectors["proofs"][0]["attachment"]);
        let quad1 = certificate(&vectors, "quad1");
        let mut alice = Member {
            certificate: certificate(&vectors, "alice"),
            key: SigningKey::from_bytes(&secret(&vectors["members"]["alice"]["seed"])),
            authority: certificate(&vectors, "authority").key,
            revoked: HashSet::new(),
            known: HashMap::from([(quad1.fingerprint, quad1.clone())]),
            last: 0,
        };
        let (key, payload) = (answer["key"].as_str().unwrap(), answer["payload"].as_str().unwrap().as_bytes());
        let proof = bytes(&answer["attachment"]);
        alice.believe("quad1", key, payload, &proof, &question).unwrap();
        assert!(alice.believe("quad2", key, payload, &proof, &question).is_err());
        assert!(alice.believe("quad1", key, b"{}", &proof, &question).is_err());
        assert!(alice.believe("quad1", key, payload, &proof, &random()).is_err());
        assert!(alice.believe("quad1", key, payload, &proof[..97], &question).is_err());
        assert!(alice.believe("quad1", key, payload, &question, &question).is_err(), "an order is no answer");
        for at in 0..UNINTRODUCED {
            let mut changed = proof.clone();
            changed[at] ^= 1;
            assert!(alice.believe("quad1", key, payload, &changed, &question).is_err(), "byte {at}");
        }
        alice.revoked.insert(hex(&quad1.fingerprint));
        assert!(alice.believe("quad1", key, payload, &proof, &question).is_err());
    }
}
