// Draws openapi.json: every path with its parameters and its body, and tries those that only read.

import { byId, fillIn, make, makeButton } from "./dom.js";
import { address } from "./settings.js";
import { followTheme } from "./theme.js";
import { t, wordsOf } from "./words.js";

/** @typedef {any} Schema a JSON schema, or another part of an OpenAPI document */

const WRITES = new Set(["send", "do", "setpoint", "release", "stream", "stop"]);

/** @type {Record<string, Schema>} */
const schemas = {};

/** @param {Schema} schema @returns {Schema} */
function resolved(schema) {
  return schema.$ref ? schemas[schema.$ref.split("/").pop()] : schema;
}

/** What a schema takes, in a few words. @param {Schema} schema @returns {string} */
function words(schema) {
  if (schema.$ref) return schema.$ref.split("/").pop();
  if (schema.anyOf) return schema.anyOf.map(words).join(t("docs.or"));
  if (schema.enum) return schema.enum.map((/** @type {any} */ each) => JSON.stringify(each)).join(t("docs.or"));
  if (schema.type === "array") return schema.prefixItems ? `[${schema.prefixItems.map(words).join(", ")}]` : t("docs.list", { of: words(schema.items || {}) });
  return schema.type || t("docs.any");
}

/** @param {Schema} schema @returns {HTMLElement[]} */
function fieldsOf(schema) {
  const full = resolved(schema);
  const table = make("table");
  for (const [name, field] of Object.entries(/** @type {Record<string, Schema>} */ (full.properties || {}))) {
    const required = (full.required || []).includes(name);
    const more = required ? t("docs.required") : field.default === undefined ? "" : t("docs.default", { value: JSON.stringify(field.default) });
    table.append(make("tr", "", "", make("th", "", "", make("code", "", name)), make("td", "muted", words(field) + more)));
  }
  return [make("p", "muted", full.description || ""), table];
}

/** Inputs for the parameters, and a button that asks and shows the answer. @param {string} path @param {Schema[]} parameters @returns {HTMLElement[]} */
function trial(path, parameters) {
  const table = make("table");
  const inputs = parameters.map((parameter) => {
    const input = make("input");
    input.setAttribute("aria-label", parameter.name);
    const name = make("th", "", "", make("code", "", parameter.name));
    table.append(make("tr", "", "", name, make("td", "", "", input, make("div", "muted", parameter.description))));
    return { parameter, input };
  });
  const button = makeButton("GET", "primary", null);
  const answer = make("pre", "answer");
  answer.hidden = true;
  button.addEventListener("click", async () => {
    let target = path.slice(1);
    const query = new URLSearchParams();
    for (const { parameter, input } of inputs) {
      if (parameter.in === "path") target = target.replace(`{${parameter.name}}`, encodeURIComponent(input.value).replace(/%2F/g, "/"));
      else if (input.value) query.set(parameter.name, input.value);
    }
    answer.hidden = false;
    answer.textContent = "…";
    try {
      const reply = await fetch(address(query.size ? `${target}?${query}` : target));
      const text = (await reply.text()).slice(0, 100000);
      let pretty = text;
      if ((reply.headers.get("content-type") || "").includes("json")) pretty = JSON.stringify(JSON.parse(text), null, 2);
      answer.textContent = `${reply.status}  /${target}\n\n${pretty}`;
    } catch (error) {
      answer.textContent = wordsOf(error);
    }
  });
  return [table, make("div", "", "", button), answer];
}

/** @param {string} path @param {string} method @param {Schema} operation */
function operationOf(path, method, operation) {
  const isSocket = Boolean(operation.responses["101"]);
  const head = make("summary", "", "", make("span", `method ${method}`, isSocket ? "WS" : method.toUpperCase()), make("code", "", path), make("span", "muted", operation.summary));
  if (operation["x-access"]) head.append(make("span", "muted access", operation["x-access"]));
  const body = make("div", "body");
  if (operation.description) body.append(make("p", "", operation.description));
  const reads = method === "get" && !isSocket && !WRITES.has(path.split("/")[1]) && path !== "/" && path !== "/docs";
  if (reads) body.append(...trial(path, operation.parameters));
  else {
    const table = make("table");
    for (const each of operation.parameters) table.append(make("tr", "", "", make("th", "", "", make("code", "", each.name)), make("td", "muted", each.description)));
    body.append(table);
  }
  const content = operation.requestBody && operation.requestBody.content["application/json"];
  if (content) body.append(...fieldsOf(content.schema));
  return make("details", "", "", head, body);
}

async function draw() {
  const reply = await fetch(address("openapi.json"));
  const openapi = await reply.json();
  if (!reply.ok) throw new Error(openapi.error.text);
  Object.assign(schemas, openapi.components.schemas);
  byId("about").textContent = t("docs.about", { text: openapi.info.description, version: openapi.info.version });
  const groups = new Map(openapi.tags.map((/** @type {Schema} */ tag) => [tag.name, [make("h2", "", tag.name, make("span", "muted", tag.description))]]));
  for (const [path, methods] of Object.entries(/** @type {Record<string, Schema>} */ (openapi.paths))) {
    for (const [method, operation] of Object.entries(methods).sort()) {
      groups.get(operation.tags[0]).push(operationOf(path, method, operation));
    }
  }
  for (const [, parts] of groups) byId("paths").append(make("section", "", "", ...parts));
}

byId("filter").addEventListener("input", () => {
  const wanted = byId("filter").value.toLowerCase();
  for (const section of document.querySelectorAll("section")) {
    const all = [...section.querySelectorAll("details")];
    for (const each of all) each.hidden = !(each.querySelector("summary")?.textContent || "").toLowerCase().includes(wanted);
    section.hidden = all.every((each) => each.hidden);
  }
});
fillIn();
followTheme();
for (const anchor of document.querySelectorAll("a")) anchor.href = address(anchor.getAttribute("href") || "");
draw().catch((error) => {
  byId("trouble").hidden = false;
  byId("trouble").textContent = t("docs.failed", { text: wordsOf(error) });
});
