//! The fleet from Rust, by Zenoh alone: an order that is asked again, a lease, a stream of setpoints, a refusal.
//!
//!     zmav sim --up                     # in another terminal
//!     cargo run                         # or with a vehicle, its fleet and a router: quad1 demo tcp/127.0.0.1:7447
//!
//! On a fleet with credentials a member's folder follows: quad1 alpha tls/10.77.0.1:7447 ~/alice

mod proof;

use std::cell::{Cell, RefCell};
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use std::{env, fmt, process, thread};

use base64::{engine::general_purpose::STANDARD, Engine};
use serde_json::{json, Value};
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};
use zenoh::{qos::CongestionControl, qos::Priority, Config, Session, Wait};

/// Asked so often in vain, 5 s each, an order is given up here; the vehicle sees through what it has heard.
const MOST_SILENT: u32 = 4;

/// Why an order was not done: the vehicle's own words, or the network's.
#[derive(Debug)]
enum Failed {
    Refused { code: String, message: String, detail: Value },
    Network(String),
}

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failed::Refused { code, message, .. } => write!(f, "refused ({code}): {message}"),
            Failed::Network(text) => write!(f, "{text}"),
        }
    }
}

fn network(error: impl fmt::Display) -> Failed {
    Failed::Network(error.to_string())
}

/// UTC seconds.
fn now() -> f64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.expect("a clock after 1970").as_secs_f64()
}

struct Vehicle {
    session: Session,
    fleet: String,
    name: String,
    /// Who we are, on a fleet with credentials.
    member: Option<RefCell<proof::Member>>,
    /// What proofs for this vehicle are to answer: its state says it, and so does a refusal.
    gate: Cell<proof::Eight>,
}

impl Vehicle {
    fn key(&self, what: &str) -> String {
        format!("zmav/{}/{}/{what}", self.fleet, self.name)
    }

    /// The first answer to a question; `None` where none comes in time. With credentials, the first that is proven.
    fn ask(&self, what: &str, payload: &Value) -> Result<Option<Value>, Failed> {
        let (key, mut sent, mut question) = (self.key(what), payload.to_string().into_bytes(), None);
        if let Some(member) = &self.member {
            if what.starts_with("do/") {
                question = Some(member.borrow_mut().prove(&key, &sent, self.gate.get()));
            } else {
                sent = proof::random().to_vec(); // of a state: a challenge, which the answer names
            }
        }
        let asked = self.session.get(&key).payload(sent.clone()).timeout(Duration::from_secs(5));
        let asked = asked.target(QueryTarget::All).consolidation(ConsolidationMode::None);
        let asked = if let Some(question) = &question { asked.attachment(question.clone()) } else { asked };
        let question = question.unwrap_or(sent);
        for reply in asked.wait().map_err(network)? {
            let Some((answer, said, proof)) = taken_apart(&reply, &key) else {
                continue; // Zenoh's own words: nobody answered in time
            };
            if let Some(member) = &self.member {
                let (answered, bytes) = said;
                if let Err(why) = member.borrow_mut().believe(&self.name, &answered, &bytes, &proof, &question) {
                    println!("{what}: an answer that is not believed: {why}");
                    continue;
                }
            }
            let Err(body) = answer else {
                return Ok(answer.ok());
            };
            let text = |name: &str| body[name].as_str().unwrap_or_default().to_owned();
            return Err(Failed::Refused {
                code: text("code"),
                message: text("message"),
                detail: body["detail"].clone(),
            });
        }
        Ok(None)
    }

    /// An order, asked again with its id until it has ended: an answer may be lost, and nothing is done twice.
    fn order(&self, verb: &str, mut arguments: Value) -> Result<Value, Failed> {
        arguments["id"] = json!(format!("rust-{}-{:.6}", process::id(), now()));
        arguments["wait"] = json!(1.0);
        let (mut signed_again, mut silent) = (0, 0);
        loop {
            let answer = self.ask(&format!("do/{verb}"), &arguments);
            silent = if matches!(answer, Ok(None)) { silent + 1 } else { 0 };
            match answer {
                Ok(Some(outcome)) if outcome["status"] == "done" => return Ok(outcome["result"].clone()),
                Ok(Some(outcome)) => println!("{verb}: not done yet {}", outcome["result"]),
                Ok(None) if silent < MOST_SILENT => println!("{verb}: no answer, asked again"),
                // A router's door says nothing of what it leaves out: what this member's role may not order, for one.
                Ok(None) => return Err(Failed::Network(format!("{verb}: nobody answers {silent} times"))),
                Err(refusal) => match mended(&refusal) {
                    Some(gate) if self.member.is_some() && signed_again < 3 => {
                        println!("{verb}: {refusal}; signed again");
                        self.gate.set(gate);
                        signed_again += 1;
                    }
                    _ => return Err(refusal),
                },
            }
        }
    }
}

type Parts = (Result<Value, Value>, (String, Vec<u8>), Vec<u8>);

/// An answer's JSON or an error's, what was said under which key, and its proof: `None` for what is no JSON.
///
/// Zenoh gives errors no attachment: the proof is in the encoding's schema, and the certificate in the detail.
fn taken_apart(reply: &Reply, asked: &str) -> Option<Parts> {
    match reply.result() {
        Ok(sample) => {
            let bytes = sample.payload().to_bytes().to_vec();
            let proof = sample.attachment().map(|found| found.to_bytes().to_vec()).unwrap_or_default();
            Some((Ok(serde_json::from_slice(&bytes).ok()?), (sample.key_expr().to_string(), bytes), proof))
        }
        Err(error) => {
            let bytes = error.payload().to_bytes().to_vec();
            let body: Value = serde_json::from_slice(&bytes).ok()?;
            let encoding = error.encoding().to_string();
            let schema = encoding.split_once(';').map(|(_, schema)| schema).unwrap_or_default();
            let certificate = body["detail"]["certificate"].as_str().unwrap_or_default();
            let proof = [schema, certificate].map(|part| STANDARD.decode(part).unwrap_or_default()).concat();
            Some((Err(body), (asked.to_owned(), bytes), proof))
        }
    }
}

/// What another proof of the same order is to answer, where another one mends the refusal.
fn mended(refusal: &Failed) -> Option<proof::Eight> {
    let Failed::Refused { detail, .. } = refusal else {
        return None;
    };
    match detail["reason"].as_str()? {
        "epoch" => proof::eight(&detail["challenge"]).or_else(|| proof::eight(&detail["gate"])),
        "clock" => proof::eight(&detail["challenge"]), // of hold, land and rtl only
        _ => None,
    }
}

fn open(router: &str, credentials: Option<&Path>) -> Result<Session, Failed> {
    let mut config = Config::default();
    let mut settings = vec![
        ("mode", json!("client")),
        ("connect/endpoints", json!([router])),
        ("scouting/multicast/enabled", json!(false)),
    ];
    if let Some(folder) = credentials {
        // Endpoints are named by address, so no name is compared with it: the authority signs members only.
        settings.extend([
            ("transport/link/tls/root_ca_certificate", json!(folder.join("ca.pem"))),
            ("transport/link/tls/connect_certificate", json!(folder.join("cert.pem"))),
            ("transport/link/tls/connect_private_key", json!(folder.join("key.pem"))),
            ("transport/link/tls/enable_mtls", json!(true)),
            ("transport/link/tls/verify_name_on_connect", json!(false)),
        ]);
    }
    for (path, value) in settings {
        config.insert_json5(path, &value.to_string()).map_err(network)?;
    }
    zenoh::open(config).wait().map_err(network)
}

/// Says who is there, as nobody has proven it; what is flown by is asked again, of the vehicle alone.
fn look(session: &Session, fleet: &str) -> Result<(), Failed> {
    for reply in session.get(format!("zmav/{fleet}/*/state")).wait().map_err(network)? {
        if let Ok(sample) = reply.result() {
            let state: Value = serde_json::from_slice(&sample.payload().to_bytes()).map_err(network)?;
            println!("{}: {} {}", state["name"], state["kind"], state["mode"]);
        }
    }
    Ok(())
}

fn fly(name: &str, fleet: &str, router: &str, credentials: Option<&Path>) -> Result<(), Failed> {
    let member = credentials.map(proof::Member::load).transpose().map_err(Failed::Network)?;
    let session = open(router, credentials)?;
    look(&session, fleet)?;
    let (fleet, name, member) = (fleet.to_owned(), name.to_owned(), member.map(RefCell::new));
    let vehicle = Vehicle { session, fleet, name, member, gate: Cell::default() };
    vehicle.order("arm", json!({}))?;
    vehicle.order("takeoff", json!({"alt_rel": 8.0}))?;
    match vehicle.order("goto", json!({"pos": [0.0, 0.0, -90000.0]})) {
        Err(refusal @ Failed::Refused { .. }) => println!("{refusal}: it flies on, nothing has changed"),
        other => println!("not refused: {other:?}"),
    }
    lead(&vehicle, 80)?;
    vehicle.order("land", json!({}))?;
    println!("landed");
    vehicle.session.close().wait().map_err(network)
}

/// Leads the vehicle to a point by so many setpoints, 20 a second, under a lease.
fn lead(vehicle: &Vehicle, count: u32) -> Result<(), Failed> {
    // While this token is there the lease is ours: the vehicle holds at once where this program dies.
    let (holder, instance) = ("rust", process::id().to_string());
    let token = vehicle.key(&format!("holder/{holder}/{instance}"));
    let alive = vehicle.session.liveliness().declare_token(token).wait().map_err(network)?;
    let key = proof::lease_key();
    let mut asked = json!({"holder": holder, "instance": instance});
    if vehicle.member.is_some() {
        asked["key"] = json!(proof::hex(x25519_dalek::PublicKey::from(&key).as_bytes()));
    }
    let granted = vehicle.order("lease", asked)?;
    let lease = granted["lease"].as_str().unwrap_or_default();
    let place = format!("{}/{}", vehicle.fleet, vehicle.name);
    let seal = granted["key"].as_str().and_then(|theirs| proof::Seal::new(&key, theirs, &place, lease));
    if vehicle.member.is_some() && seal.is_none() {
        return Err(Failed::Network("the lease came without the vehicle's key".to_owned()));
    }
    let at = vehicle.key(&format!("setpoint/{holder}"));
    let points = vehicle.session.declare_publisher(at.clone()).priority(Priority::RealTime);
    let points = points.congestion_control(CongestionControl::Drop).wait().map_err(network)?;
    for seq in 1..=count {
        let point = json!({"lease": lease, "seq": seq, "deadline": now() + 0.5, "pos": [6.0, 2.0, -8.0]}).to_string();
        let sealed = seal.as_ref().map(|seal| seal.of(&at, point.as_bytes()));
        let put = points.put(point);
        if let Some(sealed) = sealed { put.attachment(sealed) } else { put }.wait().map_err(network)?;
        thread::sleep(Duration::from_millis(50));
    }
    if let Some(state) = vehicle.ask("state", &json!({}))? {
        println!("at {} moved by {}", state["local"], state["lease"]["holder"]);
    }
    vehicle.order("release", json!({"lease": lease}))?;
    alive.undeclare().wait().map_err(network)
}

fn main() {
    let given: Vec<String> = env::args().skip(1).collect();
    let or = |index: usize, default: &'static str| given.get(index).map_or(default, String::as_str).to_owned();
    let (name, fleet, router) = (or(0, "quad1"), or(1, "demo"), or(2, "tcp/127.0.0.1:7447"));
    if let Err(error) = fly(&name, &fleet, &router, given.get(3).map(Path::new)) {
        eprintln!("{error}");
        process::exit(1);
    }
}
