//! The fleet from Rust, by Zenoh alone: an order that is asked again, a lease, a stream of setpoints, a refusal.
//!
//!     zmav sim --up                     # in another terminal
//!     cargo run                         # or with a vehicle, its fleet and a router: quad1 demo tcp/127.0.0.1:7447

use std::time::{Duration, SystemTime, UNIX_EPOCH};
use std::{env, fmt, process, thread};

use serde_json::{json, Value};
use zenoh::{qos::CongestionControl, qos::Priority, Config, Session, Wait};

/// Why an order was not done: the vehicle's own words, or the network's.
#[derive(Debug)]
enum Failed {
    Refused { code: String, message: String },
    Network(String),
}

impl fmt::Display for Failed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failed::Refused { code, message } => write!(f, "refused ({code}): {message}"),
            Failed::Network(text) => write!(f, "{text}"),
        }
    }
}

fn network(error: impl fmt::Display) -> Failed {
    Failed::Network(error.to_string())
}

/// UTC seconds.
fn now() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .expect("a clock after 1970")
        .as_secs_f64()
}

struct Vehicle {
    session: Session,
    base: String,
}

impl Vehicle {
    /// The first answer to a question; `None` where none comes in time.
    fn ask(&self, what: &str, payload: &Value) -> Result<Option<Value>, Failed> {
        let replies = self
            .session
            .get(format!("{}/{what}", self.base))
            .payload(payload.to_string())
            .timeout(Duration::from_secs(5))
            .wait()
            .map_err(network)?;
        let Ok(reply) = replies.recv() else {
            return Ok(None);
        };
        match reply.result() {
            Ok(sample) => serde_json::from_slice(&sample.payload().to_bytes())
                .map(Some)
                .map_err(network),
            Err(error) => {
                let Ok(body) = serde_json::from_slice::<Value>(&error.payload().to_bytes()) else {
                    return Ok(None); // Zenoh's own words: nobody answered in time
                };
                let text = |name: &str| body[name].as_str().unwrap_or_default().to_owned();
                Err(Failed::Refused {
                    code: text("code"),
                    message: text("message"),
                })
            }
        }
    }

    /// An order, asked again with its id until it has ended: an answer may be lost, and nothing is done twice.
    fn order(&self, verb: &str, mut arguments: Value) -> Result<Value, Failed> {
        arguments["id"] = json!(format!("rust-{}-{:.6}", process::id(), now()));
        arguments["wait"] = json!(1.0);
        loop {
            match self.ask(&format!("do/{verb}"), &arguments)? {
                Some(outcome) if outcome["status"] == "done" => {
                    return Ok(outcome["result"].clone())
                }
                Some(outcome) => println!("{verb}: not done yet {}", outcome["result"]),
                None => println!("{verb}: no answer, asked again"),
            }
        }
    }
}

fn fly(name: &str, fleet: &str, router: &str) -> Result<(), Failed> {
    let mut config = Config::default();
    let settings = [
        ("mode", r#""client""#.to_owned()),
        ("connect/endpoints", json!([router]).to_string()),
        ("scouting/multicast/enabled", "false".to_owned()),
    ];
    for (path, value) in settings {
        config.insert_json5(path, &value).map_err(network)?;
    }
    let session = zenoh::open(config).wait().map_err(network)?;
    for reply in session
        .get(format!("zmav/{fleet}/*/state"))
        .wait()
        .map_err(network)?
    {
        if let Ok(sample) = reply.result() {
            let state: Value =
                serde_json::from_slice(&sample.payload().to_bytes()).map_err(network)?;
            println!("{}: {} {}", state["name"], state["kind"], state["mode"]);
        }
    }
    let vehicle = Vehicle {
        session,
        base: format!("zmav/{fleet}/{name}"),
    };
    vehicle.order("arm", json!({}))?;
    vehicle.order("takeoff", json!({"alt_rel": 8.0}))?;
    match vehicle.order("goto", json!({"pos": [0.0, 0.0, -90000.0]})) {
        Err(refusal @ Failed::Refused { .. }) => {
            println!("{refusal}: it flies on, nothing has changed")
        }
        other => println!("not refused: {other:?}"),
    }

    // While this token is there the lease is ours: the vehicle holds at once where this program dies.
    let (holder, instance) = ("rust", format!("{}", process::id()));
    let token = format!("{}/holder/{holder}/{instance}", vehicle.base);
    let alive = vehicle
        .session
        .liveliness()
        .declare_token(token)
        .wait()
        .map_err(network)?;
    let granted = vehicle.order("lease", json!({"holder": holder, "instance": instance}))?;
    let points = vehicle
        .session
        .declare_publisher(format!("{}/setpoint/{holder}", vehicle.base))
        .priority(Priority::RealTime)
        .congestion_control(CongestionControl::Drop)
        .wait()
        .map_err(network)?;
    for seq in 1..=80 {
        let point = json!({
            "lease": granted["lease"], "seq": seq, "deadline": now() + 0.5, "pos": [6.0, 2.0, -8.0]
        });
        points.put(point.to_string()).wait().map_err(network)?;
        thread::sleep(Duration::from_millis(50));
    }
    if let Some(state) = vehicle.ask("state", &json!({}))? {
        println!(
            "at {} moved by {}",
            state["local"], state["lease"]["holder"]
        );
    }
    vehicle.order("release", json!({"lease": granted["lease"]}))?;
    alive.undeclare().wait().map_err(network)?;
    vehicle.order("land", json!({}))?;
    println!("landed");
    vehicle.session.close().wait().map_err(network)
}

fn main() {
    let given: Vec<String> = env::args().skip(1).collect();
    let or = |index: usize, default: &'static str| {
        given.get(index).map_or(default, String::as_str).to_owned()
    };
    if let Err(error) = fly(
        &or(0, "quad1"),
        &or(1, "demo"),
        &or(2, "tcp/127.0.0.1:7447"),
    ) {
        eprintln!("{error}");
        process::exit(1);
    }
}
