"use strict";
// The bar of orders: for the selected, or for all where nobody is. It names whom it means before it is pressed.

class OrderBar {
  /** @param {Store} store @param {FleetMap} view @param {PlanLayer} plans */
  constructor(store, view, plans) {
    this.store = store;
    this.view = view;
    this.plans = plans;
    const bar = byId("bar");
    const add = (label, className, act, title) => {
      const button = makeButton(label, className, act, title);
      bar.append(button);
      return button;
    };
    this.hold = add("Hold", "safe", () => order(this.ids, "hold"), "stop where they are, at once");
    this.pause = add("Pause", "safe", () => this.pauseOrResume(), "come to rest along what is flown; the goals stay");
    this.land = add("Land", "safe", null, "land where they are; who is disarmed is left out");
    this.rtl = add("Return", "safe", null, "home and land: by a plan in which nobody meets, where a planner is; who is disarmed is left out");
    /** A second press is for whom the first one named: another selection takes it back. */
    this.asked = [armTwice(this.land, () => order(this.ids, "land")), armTwice(this.rtl, () => order(this.ids, "rtl"))];
    this.meant = "";
    this.land.dataset.verb = "land";
    this.rtl.dataset.verb = "rtl";
    this.hold.dataset.verb = "hold";
    bar.append(make("span", "divider"));
    /** What moves or arms: for the selected only. */
    this.moving = [
      add("Arm…", "", () => this.arm(), ""),
      add("Take off…", "", () => this.takeoff(), ""),
      add("Mode…", "", () => this.mode(), ""),
      add("Go here…", "", () => this.goHere(), "then click on the map"),
    ];
    this.moving[3].dataset.tool = "go";
  }

  /** @returns {string[]} whom a press means now */
  get ids() {
    return this.store.selected.size ? [...this.store.selected] : ["*"];
  }

  get names() {
    return this.store.chosen.map((vehicle) => vehicle.name);
  }

  draw() {
    const all = this.store.all.length;
    const live = this.store.connection === "live";
    byId("everybody").hidden = READ_ONLY || all === 0;
    const meant = this.ids.join(" ");
    if (meant !== this.meant) for (const rest of this.asked) rest();
    this.meant = meant;
    say(byId("whom-names"), this.store.selected.size ? `${few(this.names, 6)}${all > 1 ? ` (${this.names.length} of ${all})` : ""}` : `all ${all}`);
    const count = this.store.selected.size;
    const suffix = count === 0 ? " all" : count === 1 ? ` ${this.names[0] || ""}` : ` ${count}`;
    for (const [button, label] of [[this.hold, "Hold"], [this.land, "Land"], [this.rtl, "Return"]]) if (!button.classList.contains("asking")) say(button, label + suffix);
    for (const button of this.moving) button.disabled = !live || count === 0;
    const flying = this.goalsOf();
    const paused = flying.length > 0 && flying.every((entry) => entry.state === "paused");
    say(this.pause, paused ? "Go on" : "Pause");
    this.pause.disabled = !live || !this.store.planner || flying.length === 0;
    this.pause.title = this.store.planner ? "come to rest along what is flown; the goals stay" : "there is no planner: Hold stops them";
  }

  /** Open goals of whom is meant. */
  goalsOf() {
    const names = new Set(this.names);
    return this.store.openGoals.filter((entry) => !names.size || entry.goal.vehicles.some((name) => names.has(name)));
  }

  async pauseOrResume() {
    const goals = this.goalsOf();
    const verb = goals.every((entry) => entry.state === "paused") ? "resume" : "pause";
    const whole = !this.store.selected.size;
    for (const goal of whole ? [""] : goals.map((entry) => entry.id)) await askPlanner(verb, { goal });
  }

  async arm() {
    const armed = this.store.chosen.every((vehicle) => vehicle.state.armed);
    const verb = armed ? "disarm" : "arm";
    const text = armed ? "Their motors stop. It is refused in the air." : "Their motors start to turn. Is everybody clear of them?";
    const ids = this.ids;
    if (await confirmed(`${armed ? "Disarm" : "Arm"} ${few(this.names, 8)}?`, text, armed ? "Disarm" : "Arm")) await order(ids, verb);
  }

  /** Several go only where nothing hinders one of them, and by the planner, in an order in which nobody meets, where there is one. */
  async takeoff() {
    const chosen = this.store.chosen;
    const names = this.names;
    const hindered = chosen.filter((vehicle) => vehicle.hindrances.length);
    if (chosen.length > 1 && hindered.length) {
      showTab("preflight");
      toast(`No takeoff of ${names.length}: ${hindered.map((vehicle) => `${vehicle.name}: ${vehicle.hindrances[0]}`).join("; ")}. Select the others, or see to it.`, "bad", 15000);
      return;
    }
    const planned = this.store.planner && chosen.length > 1;
    const field = { label: "Height above home", value: 10 };
    const how = planned ? "The planner takes them up, in an order in which nobody meets." : "They climb at once, each straight up.";
    const ids = this.ids;
    const height = await confirmed(`Take off with ${few(names, 8)}?`, `${how} Is the air above them free?`, "Take off", field);
    if (!(height > 0)) return;
    if (planned) await askPlanner("submit", { goal: { kind: "takeoff", vehicles: names, height } });
    else await order(ids, "takeoff", { alt_rel: height });
  }

  async mode() {
    const ids = this.ids;
    const options = [...new Set(this.store.all.map((vehicle) => vehicle.state.mode).filter((mode) => typeof mode === "string"))];
    const field = { label: "Mode", value: "", type: /** @type {"text"} */ ("text"), options };
    const mode = await confirmed(`Another mode for ${few(this.names, 8)}`, "By the autopilot's own name; a pilot's mode takes the vehicle from the programs.", "Set", field);
    if (mode) await order(ids, "set_mode", { mode });
  }

  goHere() {
    if (this.view.tool && this.view.tool.name === "go") return this.view.end();
    this.view.begin(`Click where ${few(this.names, 6)} ${this.names.length > 1 ? "are" : "is"} to go; Esc ends it`, {
      name: "go",
      click: (place) => {
        this.view.end();
        this.go(place);
      },
    });
  }

  /** @param {Place} place */
  async go(place) {
    const chosen = this.store.chosen.filter((vehicle) => vehicle.placed);
    if (this.store.planner && this.store.origin) return this.goPlanned(chosen, place);
    if (chosen.length !== 1) return toast("Several are led by the planner only: start one with 'zmav swarm planner', or select one", "bad", 12000);
    const [vehicle] = chosen;
    const way = wayBetween(vehicle.place, place);
    const text = `${metres(way.distance)} at ${Math.round(way.bearing) % 360}°, straight: no planner looks at what stands there. The vehicle keeps to its own fence.`;
    const field = { label: "Height above home", value: Math.max(1, Math.round(vehicle.height || 10)) };
    const height = await confirmed(`Send ${vehicle.name} there?`, text, "Go", field);
    if (!(height > 0)) return;
    const where = this.store.nowhere ? { frame: "ned", pos: [...toNed(this.store.origin, place), -height] } : { frame: "global", lat_deg: place.lat, lon_deg: place.lon, alt_rel: height };
    await order([vehicle.id], "goto", where);
  }

  /** They keep their places about their middle, and their heights. */
  async goPlanned(chosen, place) {
    const flying = chosen.filter((vehicle) => vehicle.state.local);
    if (!flying.length) return toast("The planner needs the fleet's origin: none of them says where it is about it", "bad", 12000);
    const middle = [0, 1].map((i) => flying.reduce((sum, vehicle) => sum + vehicle.state.local[i], 0) / flying.length);
    const [north, east] = toNed(this.store.origin, place);
    const to = flying.map(({ state }) => [north + state.local[0] - middle[0], east + state.local[1] - middle[1], state.local[2]]);
    await planFirst({ kind: "goto", vehicles: flying.map((vehicle) => vehicle.name), to, labelled: true }, this.plans);
  }
}

/** Ask the planner in charge, and say what came of it. @param {string} verb @param {any} args @returns {Promise<any>} */
async function askPlanner(verb, args) {
  try {
    const { result } = await post(`swarm/${verb}`, args);
    const goals = result.goals ? result.goals.join(", ") || "nothing" : result.goal || "";
    toast(`planner: ${verb} ${goals}`, "good", 5000);
    return result;
  } catch (error) {
    toast(`planner: not done: ${verb}: ${error.message}`, "bad", 15000);
    return null;
  }
}

/** Show what would be flown, and have it flown if a person agrees. @param {any} goal @param {PlanLayer} plans */
async function planFirst(goal, plans) {
  const names = few(goal.vehicles, 8);
  const box = toast(`The planner looks for a way for ${names} …`, "", 0);
  let preview;
  try {
    preview = (await post("swarm/preview", { goal })).result;
  } catch (error) {
    toast(`No plan for ${names}: ${error.message}`, "bad", 15000);
    return;
  } finally {
    box.remove();
  }
  plans.preview(preview.steps);
  plans.draw();
  const clear = preview.clearance === null ? "" : `, ${metres(preview.clearance)} between the nearest two`;
  const yes = await confirmed(`${goal.kind} with ${names}?`, `${span(preview.makespan)}${clear}. The dotted ways on the map are what would be flown.`, "Fly it", null, true);
  plans.preview([]);
  if (yes) await askPlanner("submit", { goal });
}
