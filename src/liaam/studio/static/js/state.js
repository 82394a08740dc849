// What the page knows of the folder, and the server's events that keep it so.

import { api, ApiError } from "./api.js";

const LOOK_EVERY = 4000; // milliseconds between two looks at the folder

/** The picture that an address names; none where somebody has written the address by hand, and wrongly. */
export function nameIn(hash) {
  try {
    return decodeURIComponent(hash.slice(1));
  } catch {
    return "";
  }
}

export class State extends EventTarget {
  constructor() {
    super();
    this.project = null;
    this.current = null;
    this.online = true;
    this.unsure = false; // whether the server may be another one since: its port may be of another folder now
    this._refreshing = null;
    this._again = false;
  }

  /** Read the folder's state, and follow it. */
  async open() {
    const wanted = nameIn(location.hash); // before another picture is chosen
    await this.refresh();
    const names = this.project.pictures.map((picture) => picture.name);
    this.select(names.includes(wanted) ? wanted : this._first());
    this._follow();
    this._watch();
  }

  picture(name = this.current) {
    return this.project?.pictures.find((picture) => picture.name === name) ?? null;
  }

  /** Fetch the project anew; calls while one is under way become one more. */
  refresh() {
    if (this._refreshing) {
      this._again = true;
      return this._refreshing;
    }
    this._refreshing = this._fetch().finally(() => {
      this._refreshing = null;
      if (this._again) {
        this._again = false;
        this.refresh().catch(() => {});
      }
    });
    return this._refreshing;
  }

  select(name) {
    if (name === this.current) return;
    const before = this.current;
    this.current = name;
    // The address remembers the picture over a reload.
    history.replaceState(null, "", name ? `#${encodeURIComponent(name)}` : location.pathname);
    this._say("select", { name, before });
  }

  /** Select the picture so many places on, among those that can be opened. */
  step(by) {
    const names = this.project.pictures.filter((picture) => picture.state !== "broken").map((picture) => picture.name);
    if (!names.length) return;
    const at = names.indexOf(this.current);
    this.select(names[Math.min(Math.max(at + by, 0), names.length - 1)]);
  }

  /** Take over what a save has told of one picture, without fetching all. */
  update(picture) {
    const at = this.project.pictures.findIndex((other) => other.name === picture.name);
    if (at < 0) return;
    this.project.pictures[at] = picture;
    this._say("project");
  }

  /** What other programs do in the folder comes by no event: look again, cheaply, while the page is seen. */
  async look() {
    if (document.hidden || this._refreshing || !this.project) return;
    const { stamp } = this.project;
    if (stamp === undefined) {
      await this.refresh();
      return;
    }
    const project = await api.get(api.url("project", { stamp }));
    if (!project.unchanged && !this._refreshing) this._take(project);
  }

  _watch() {
    const look = () => this.look().catch(() => {}); // a lost server is told by the events
    addEventListener("focus", look);
    document.addEventListener("visibilitychange", look);
    setInterval(() => {
      if (this.project?.stamp !== undefined) look();
    }, LOOK_EVERY);
  }

  /** Send what was made for this page's folder: `request` is given the folder's id, for the server to refuse it where
   *  another folder is served at this address by now. The page is then loaded anew, and this rejects. */
  async send(request) {
    if (this.unsure) await this.refresh(); // else at once: the page may be going away
    try {
      return await request(this.project.id);
    } catch (error) {
      if (error.body?.folder) await this.refresh();
      throw error;
    }
  }

  _take(project) {
    if (this.project && this.project.id !== project.id) {
      location.reload(); // what is not saved is kept for the folder that it is of
      throw new ApiError("The studio shows another folder now.", 0);
    }
    this.unsure = false;
    this.project = project;
    if (!this.picture()) this.select(this._first());
    this._say("project");
  }

  async _fetch() {
    try {
      this._take(await api.get(api.url("project")));
      this._online(true);
    } catch (error) {
      if (error.unreachable) this._online(false);
      throw error;
    }
  }

  _first() {
    const pictures = this.project.pictures.filter((picture) => picture.state !== "broken");
    return (pictures.find((picture) => picture.state !== "done") ?? pictures[0])?.name ?? null;
  }

  _follow() {
    const source = new EventSource("/api/events");
    let lost = false;
    source.addEventListener("open", () => {
      this._online(true);
      if (lost) this.refresh().catch(() => {});
      lost = false;
    });
    source.addEventListener("error", () => {
      lost = true;
      this.unsure = true;
      this._online(false);
      // A browser gives up for good where the answer was an error: a server started anew has another token.
      if (source.readyState === EventSource.CLOSED) setTimeout(() => this._follow(), 2000);
    });
    source.addEventListener("project", () => this.refresh().catch(() => {}));
    source.addEventListener("training", (event) => {
      this.project.training = JSON.parse(event.data);
      this._say("training", this.project.training);
    });
    source.addEventListener("landmarks", (event) => this._say("landmarks", JSON.parse(event.data)));
    addEventListener("pagehide", () => source.close());
  }

  _online(online) {
    if (online === this.online) return;
    this.online = online;
    this._say("online", online);
  }

  _say(type, detail = null) {
    this.dispatchEvent(new CustomEvent(type, { detail }));
  }
}
