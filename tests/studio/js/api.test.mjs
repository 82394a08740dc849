// What the page asks the server, and how often. Run by test_api_module.py, by Node.

import assert from "node:assert/strict";
import { test } from "node:test";

import { answers, api, ApiError, url } from "./modules/api.js";

/** Answer requests one by one; waits take no time. */
function served(t, ...answers) {
  const asked = [];
  const waits = [];
  t.mock.method(globalThis, "fetch", async (address, options) => {
    asked.push([address, options.method ?? "GET"]);
    return answers.length > 1 ? answers.shift()() : answers[0]();
  });
  t.mock.method(globalThis, "setTimeout", (call, milliseconds) => {
    waits.push(milliseconds);
    queueMicrotask(call);
  });
  return { asked, waits };
}

const busy = () => new Response('{"error": "busy"}', { status: 503, headers: { "retry-after": "2" } });
const full = () => new Response('{"error": "the disk refuses"}', { status: 503 });
const good = () => new Response('{"id": 7}');

test("an address has what varies in its route, and the rest as its query", () => {
  const fields = { name: "a b/c?.png", size: 512, tag: "1-2", scale: null };
  assert.equal(url("pictures/{name}/image", fields), "/api/pictures/a%20b/c%3F.png/image?size=512&tag=1-2");
  assert.equal(url("fits/{id}/layers/{layer}", { id: 7, layer: "flat" }), "/api/fits/7/layers/flat");
  assert.equal(url("project"), "/api/project");
  assert.equal(url("project", { stamp: undefined }), "/api/project");
});

test("landmarks are saved under the server's name, and it is known whether they are of both sides", async (t) => {
  const headers = { "content-disposition": "attachment; filename*=UTF-8''w.tps" };
  served(t, () => new Response("a", { headers: { ...headers, "x-both-sides": "true" } }), () => new Response("b", { headers }));
  const { file: [blob, name], hasBothSides } = await api.landmarks("tps");
  assert.deepEqual([await blob.text(), name, hasBothSides], ["a", "w.tps", true]);
  assert.equal((await api.landmarks("tps")).hasBothSides, false);
});

test("a busy server is asked again after the time that it says", async (t) => {
  const { asked, waits } = served(t, busy, busy, good);
  assert.deepEqual(await api.upload("/api/uploads", "bytes"), { id: 7 });
  assert.deepEqual(asked, Array(3).fill(["/api/uploads", "POST"]));
  assert.ok(waits.length === 2 && waits.every((wait) => wait >= 2000 && wait <= 4000), waits);
});

test("but not for ever", async (t) => {
  const { asked } = served(t, busy);
  await assert.rejects(api.get("/api/project"), (fault) => fault instanceof ApiError && fault.status === 503 && fault.message === "busy");
  assert.equal(asked.length, 10);
});

test("a refusal that names no time is told at once, and a later success is told to be about the same", async (t) => {
  const { asked } = served(t, full, good);
  const told = [];
  answers.addEventListener("good", ({ detail }) => told.push(detail));
  const about = "PUT /api/template";
  await assert.rejects(api.put("/api/template?new=1", {}), { message: "the disk refuses", status: 503, about });
  assert.equal(asked.length, 1);
  await api.put("/api/template", {});
  assert.deepEqual(told, [about]);
});
