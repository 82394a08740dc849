// The server's HTTP interface: one function a verb, and one kind of error, with a sentence for people.

export class ApiError extends Error {
  /** @param {string} message a sentence; @param {number} status 0 where the server could not be reached. */
  constructor(message, status, body = null) {
    super(message);
    this.name = "ApiError";
    this.status = status;
    this.body = body;
  }

  get unreachable() {
    return this.status === 0;
  }
}

const UNREACHABLE = "The studio's server cannot be reached. Is 'liaam studio' still running?";

/** Address of a path whose parts are given apart: url("pictures", name, "image", {size: 512}). */
export function url(...parts) {
  const query = parts.length && typeof parts.at(-1) === "object" ? parts.pop() : null;
  const path = parts.map((part) => String(part).split("/").map(encodeURIComponent).join("/")).join("/");
  const text = query ? new URLSearchParams(Object.entries(query).filter(([, value]) => value != null)).toString() : "";
  return `/api/${path}${text ? `?${text}` : ""}`;
}

async function send(address, options) {
  let response;
  try {
    response = await fetch(address, { credentials: "same-origin", ...options });
  } catch (fault) {
    if (fault.name === "AbortError") throw fault;
    throw new ApiError(UNREACHABLE, 0);
  }
  if (response.ok) return response;
  const body = await response.json().catch(() => null);
  throw new ApiError(body?.error ?? `The server answered ${response.status} ${response.statusText}.`, response.status, body);
}

async function json(address, options) {
  const response = await send(address, options);
  return response.status === 204 ? null : response.json();
}

function withBody(method) {
  return (address, body = {}, options = {}) =>
    json(address, { method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body), ...options });
}

export const api = {
  url,
  get: (address, options = {}) => json(address, options),
  put: withBody("PUT"),
  post: withBody("POST"),
  delete: withBody("DELETE"),
  /** Send a file as it is. */
  upload: (address, blob, options = {}) =>
    json(address, { method: "POST", headers: { "Content-Type": "application/octet-stream" }, body: blob, ...options }),
  buffer: async (address, options = {}) => (await send(address, options)).arrayBuffer(),
  blob: async (address, options = {}) => (await send(address, options)).blob(),
  /** A file to save: {blob, disposition: what the server says of its name}. */
  file: async (address, options = {}) => {
    const answer = await send(address, options);
    return { blob: await answer.blob(), disposition: answer.headers.get("content-disposition") };
  },
};
