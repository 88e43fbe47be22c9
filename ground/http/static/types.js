// What the gateway sends, as far as the page reads it: zmav/wire/state.py, zmav/wire/swarm.py, zmav/doctor.

/**
 * @typedef {import("./words.js").Level} Level
 * @typedef {{lat: number, lon: number}} Place degrees, WGS84
 * @typedef {[number, number, number]} Vector NED, m or m/s
 *
 * @typedef {object} State of a vehicle
 * @property {number} [t] UTC s
 * @property {boolean} [replayed]
 * @property {number | null} [sysid]
 * @property {string | null} [autopilot]
 * @property {string | null} [kind]
 * @property {string | null} [mode]
 * @property {boolean | null} [armed]
 * @property {boolean | null} [landed]
 * @property {boolean | null} [ready]
 * @property {string[]} [not_ready]
 * @property {{lat_deg: number, lon_deg: number, alt_amsl: number, alt_rel: number} | null} [position]
 * @property {Vector | null} [local]
 * @property {Vector | null} [velocity]
 * @property {{roll: number, pitch: number, yaw: number} | null} [attitude]
 * @property {{voltage?: number | null, remaining?: number | null, time_left?: number | null} | null} [battery] time_left: s
 * @property {{age: number | null, source: string, baseline?: number | null} | null} [corrections] age in s, baseline in m
 * @property {{fix: string, satellites?: number | null, hdop?: number | null, h_acc?: number | null} | null} [gps] h_acc: m
 * @property {number} [link_loss]
 * @property {{holder: string} | null} [lease]
 * @property {string} [mover]
 *
 * @typedef {{symbol: string, u: number, v: number, scale_px: number, heading: number, score: number}} Sight in a picture: px, radians clockwise from up
 * @typedef {{t: number, width: number, height: number, found: Sight[]}} Sights of one picture, by a program that looks
 *
 * @typedef {{rule: string, level: Level, text: string, advice: string}} Alarm what is not well, by the rules of zmav/doctor
 * @typedef {{name: string, t: number, severity: string, text: string}} FleetEvent
 *
 * @typedef {{kind: string, vehicles: string[]} & Record<string, any>} Goal
 * @typedef {{id: string, goal: Goal, state: string, text: string, progress: number, clearance: number | null}} GoalEntry
 * @typedef {{planner: string, term: number, goals: GoalEntry[]}} Book of the planner in charge
 * @typedef {number[]} TrackPoint seconds after the start, then m NED about the fleet's origin
 * @typedef {Record<string, TrackPoint[]>} Tracks by vehicle
 * @typedef {{goal: string, start: number, makespan: number, tracks: Tracks}} Plan start: UTC seconds
 * @typedef {{seconds: number, metres: number, battery: number, battery_left: number | null, pictures?: number}} Figures
 * @typedef {{tracks?: Tracks, makespan: number, text?: string, figures?: Record<string, Figures>}} Step of a preview, which begins where the one before it ends
 *
 * @typedef {object} What an obstacle is
 * @property {string} shape
 * @property {[number, number][]} [polygon]
 * @property {number[]} [center]
 * @property {number[]} [velocity]
 * @property {number} [radius]
 * @property {number[]} [low]
 * @property {number[]} [high]
 * @property {number} [floor]
 * @property {number} [ceiling]
 * @typedef {{name: string, t: number, what: What}} Obstacle
 *
 * @typedef {{a: string, b: string, grade: string, loss: number | null, rtt: number | null}} MeshLink
 * @typedef {{weakest: {grade: string, ends: string[]} | null, rtt: number | null} | null} Network
 * @typedef {{fleet: string, name: string, reasons: Alarm[], network: Network}} VehicleReport
 * @typedef {object} Aircraft that is not of the fleet
 * @property {string} icao
 * @property {string} callsign
 * @property {number} lat_deg
 * @property {number} lon_deg
 * @property {Vector | null} velocity
 * @property {number} age s since it was there
 * @property {string} source
 * @property {number | null} alt_amsl m
 * @property {string | null} vehicle the nearest
 * @property {number | null} distance m from it
 * @property {number | null} height m above it
 * @property {number | null} nearest m at the closest approach
 * @property {number | null} time s until then
 *
 * @typedef {{links: MeshLink[], vehicles: VehicleReport[], aircraft: Aircraft[]}} Report of GET /report
 *
 * @typedef {{key: string, t: number, value: any, alarms?: Alarm[], deleted?: boolean}} Message of a key
 * @typedef {{hz?: number, history?: number, changes?: boolean}} How a key is read
 */

export {};
