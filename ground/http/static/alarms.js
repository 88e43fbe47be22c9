"use strict";
// One list of what is not well, the worst first, until it is gone; a person says that he has seen it. The rules are the
// gateway's, which has them from zmav/doctor.

class Alarms {
  /** @param {Store} store */
  constructor(store) {
    this.store = store;
    /** @type {Map<string, any>} */
    this.rows = new Map();
    this.list = make("ol", "alarms");
    this.none = make("p", "muted", "Nothing: all is well.");
    byId("alarms").append(this.none, this.list);
  }

  /** @returns {{key: string, who: string, id: string, alarm: Alarm}[]} */
  get all() {
    const found = this.store.all.flatMap((vehicle) => vehicle.troubles.map((alarm) => ({ key: `${vehicle.id} ${alarm.rule}`, who: vehicle.name, id: vehicle.id, alarm })));
    if (this.store.openGoals.length && !this.store.planner && this.store.connection === "live")
      found.push({ key: "planner", who: "planner", id: "", alarm: { rule: "planner", level: "bad", text: `${this.store.book.planner} is not heard, and its goals are open`, advice: "a vehicle holds at the end of what it flies; a standby takes over, or start 'zmav swarm planner' again" } });
    return found;
  }

  draw() {
    const all = this.all;
    const now = new Set(all.map((each) => each.key));
    for (const key of this.store.seen.keys()) if (!now.has(key)) this.store.seen.delete(key);
    for (const [key, row] of this.rows) {
      if (now.has(key)) continue;
      row.element.remove();
      this.rows.delete(key);
    }
    const rank = ({ key, alarm }) => LEVELS.indexOf(alarm.level) + (this.store.seen.has(key) ? 10 : 0);
    all.sort((a, b) => rank(a) - rank(b));
    for (const each of all) this.drawRow(each);
    const order = all.map((each) => this.rows.get(each.key).element);
    if (order.some((element, index) => this.list.children[index] !== element)) this.list.append(...order);
    this.none.hidden = all.length > 0;
    const open = all.filter((each) => !this.store.seen.has(each.key) && each.alarm.level !== "note");
    const count = byId("alarm-count");
    say(count, open.length ? String(open.length) : "");
    count.className = open.length ? `pill ${open.some((each) => each.alarm.level === "bad") ? "hot" : "warned"}` : "";
  }

  drawRow({ key, who, id, alarm }) {
    let row = this.rows.get(key);
    if (!row) {
      const words = make("span");
      const whom = makeButton(who, "plain", () => id && this.store.select([id]), `select ${who}`);
      const seen = makeButton("Seen", "small", () => this.store.seen.set(key, Date.now()), "a person knows of it");
      const element = make("li", "", "", make("b", "level"), make("div", "", "", whom, words, make("p", "muted", alarm.advice)), seen);
      row = { element, words, seen };
      this.rows.set(key, row);
      this.list.append(element);
    }
    const known = this.store.seen.has(key);
    row.element.className = `${alarm.level}${known ? " seen" : ""}`;
    say(row.element.firstChild, LEVEL_WORD[alarm.level]);
    say(row.words, alarm.text);
    row.seen.hidden = known || alarm.level === "note";
  }
}
