// The server's HTTP interface: a function for each verb, and an error with a message for the user.

export class ApiError extends Error {
  /** @param {string} message for the user; @param {number} status HTTP status, 0 if the server is unreachable;
   *  @param {string} about what was asked for, see `subjectOf` */
  constructor(message, status, body = null, about = "") {
    super(message);
    this.name = "ApiError";
    this.status = status;
    this.about = about;
    /** @type {Partial<Fault> | null} */
    this.body = body;
  }

  get unreachable() { return this.status === 0; }
}

const UNREACHABLE = "The server is not reachable. Is 'liaam studio' still running?";

/** What the addresses of a further set of landmarks begin with, of which the page is one. */
const SET = /^\/set\/[^/]+/.exec(globalThis.location?.pathname ?? "")?.[0] ?? "";

const encoded = (name) => String(name).split("/").map(encodeURIComponent).join("/");

/** Address of a route, with what varies in it: url("pictures/{name}/image", {name, size: 512}). Fields that the route does
 *  not name are its query, without those that are null. @type {Api["url"]} */
export const url = (route, ...[fields = {}]) => {
  const query = new Map(Object.entries(fields).filter(([, value]) => value != null));
  const path = route.replace(/{(\w+)}/g, (_, name) => {
    query.delete(name);
    return encoded(fields[name]);
  });
  const text = new URLSearchParams([...query]).toString();
  return /** @type {any} */ (`${SET}/api/${path}${text ? `?${text}` : ""}`);
};

/** Address of a file of the page, beside this module, where the browser keeps it. */
export const fileOf = (name) => new URL(`../${name}`, import.meta.url).href;

const TRIES = 10; // attempts of a request to a busy server, about half a minute

/** Event "change": the number of requests that the user waits for has changed. */
class Busy extends EventTarget {
  #count = 0;

  get count() { return this.#count; }

  add(by) {
    this.#count += by;
    this.dispatchEvent(new Event("change"));
  }
}

export const busy = new Busy();

/** Tells listeners of "good" what was asked for with success: errors about it are out of date. */
export const answers = new EventTarget();

/** What a request is about: its verb and its address without the query. */
const subjectOf = (address, { method = "GET" }) => `${method} ${address.split("?")[0]}`;

async function send(address, { quiet = false, ...options } = {}) {
  if (!quiet) busy.add(1);
  return request(address, options).finally(() => quiet || busy.add(-1));
}

async function request(address, options) {
  let response;
  for (let tries = 1; ; tries += 1) {
    try {
      response = await fetch(address, { credentials: "same-origin", ...options });
    } catch {
      throw new ApiError(UNREACHABLE, 0);
    }
    // Retry only if the server asks for it. Other 503 errors, such as a full disk, are shown.
    const wait = Number(response.headers.get("retry-after"));
    if (response.status !== 503 || !(wait > 0) || tries === TRIES) break;
    const delay = 1000 * Math.min(wait, 10) * (1 + Math.random()); // random, to spread retries
    await new Promise((resolve) => { setTimeout(resolve, delay); });
  }
  const about = subjectOf(address, options);
  if (response.ok) {
    answers.dispatchEvent(new CustomEvent("good", { detail: about }));
    return response;
  }
  /** @type {Fault | null} */
  const body = await response.json().catch(() => null);
  const message = body?.error ?? `The server answered ${response.status} ${response.statusText}.`;
  throw new ApiError(message, response.status, body, about);
}

async function json(address, options) {
  const response = await send(address, options);
  return response.status === 204 ? null : response.json();
}

/** File name in a Content-Disposition header of the server. */
export function fileNameIn(disposition) {
  const [, encoded] = /filename\*=UTF-8''([^;]+)/i.exec(disposition ?? "") ?? [];
  return encoded ? decodeURIComponent(encoded) : "file";
}

/** A file to save: [blob, name]. @param {Response} answer; @returns {Promise<[Blob, string]>} */
const attached = async (answer) => [await answer.blob(), fileNameIn(answer.headers.get("content-disposition"))];

function withBody(method) {
  return (address, body = {}, options = {}) =>
    json(address, { method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body), ...options });
}

/** @type {Api} */
export const api = {
  url,
  get: (address, options = {}) => json(address, options), put: withBody("PUT"), post: withBody("POST"),
  delete: withBody("DELETE"),
  upload: (address, blob, options = {}) =>
    json(address, { method: "POST", headers: { "Content-Type": "application/octet-stream" }, body: blob, ...options }),
  buffer: async (address, options = {}) => (await send(address, options)).arrayBuffer(),
  blob: async (address, options = {}) => (await send(address, options)).blob(),
  /** A picture, and what the server says of its colours. */
  layer: async (address) => {
    const answer = await send(address);
    return { image: await createImageBitmap(await answer.blob()), scale: JSON.parse(answer.headers.get("x-scale")) };
  },
  /** A file to save: [blob, name]. */
  file: async (address, options = {}) => attached(await send(address, options)),
  /** A file with the landmarks of all pictures, and whether specimens of two sides are in it. */
  landmarks: async (kind) => {
    const answer = await send(url("export/{kind}", { kind }));
    return { file: await attached(answer), hasBothSides: answer.headers.has("x-both-sides") };
  },
};
