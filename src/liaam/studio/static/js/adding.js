// Bringing files in: pictures and landmark files are added to the folder, a model is used, and a video is followed.

import { several } from "./annotate-words.js";
import { api } from "./api.js";
import { takeWork } from "./unsaved.js";
import { baseOf } from "./strip-filters.js";
import { h, icon, isTyping, toast } from "./ui.js";

const AT_ONCE = 4; // files sent at a time
const SURE = 0.5; // least quality of a fit of the face model to a portrait
const SHOWN = 3; // reasons in the summary
const IGNORED = /(^|\/)(\.|Thumbs\.db$|desktop\.ini$)/i;
const UNSAVED = /^\{"kind":"liaam-studio-unsaved"/;
const suffixOf = (path) => /\.[^./]+$/.exec(path.toLowerCase())?.[0] ?? "";
const stemOf = (path) => path.slice(0, path.length - suffixOf(path).length);
const isVideo = ({ file, path }, /** @type {Formats} */ { videos }) => file.type.startsWith("video/") || videos.includes(suffixOf(path));

/** All files of a drop with their paths: [{file, path}]; folders are opened. */
async function filesIn(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.some(({ isDirectory }) => isDirectory)) return [...transfer.files].map((file) => ({ file, path: file.name }));
  const found = [];
  for (const entry of entries) await collect(entry, found);
  return found;
}

async function collect(entry, found) {
  const file = entry.isFile && (await new Promise((resolve, reject) => { entry.file(resolve, reject); }));
  if (file) return found.push({ file, path: entry.fullPath.slice(1) });
  const reader = entry.createReader();
  for (;;) { // a browser lists a hundred entries at a time
    const some = await new Promise((resolve, reject) => { reader.readEntries(resolve, reject); });
    if (!some.length) return found;
    for (const each of some) await collect(each, found);
  }
}

/** Names in the folder for the paths of files: without their folders, unless two would then share a name. */
export function namesFor(paths) {
  const folders = new Map(); // stem -> folder
  const clash = paths.some((path) => {
    const [stem, folder] = [stemOf(baseOf(path)), path.slice(0, path.lastIndexOf("/") + 1)];
    const other = folders.get(stem) ?? folder;
    folders.set(stem, folder);
    return other !== folder;
  });
  return paths.map((path) => (clash ? path.split("/").join("_") : baseOf(path)));
}

/** What was added, in one sentence; refused: sentences, of which each says why a file was left out. */
export function summary({ pictures, known, landmarks, placed, refused }) {
  const reasons = refused.map((reason) => reason.replace(/\.$/, ""));
  const parts = [
    (pictures || !(known || landmarks)) && `${several(pictures, "picture")} added`,
    known && `${several(known, "file")} already here`,
    landmarks && `landmarks for ${placed}`,
    reasons.length && `${several(reasons.length, "file")} left out: ${reasons.slice(0, SHOWN).join("; ")}` +
      (reasons.length > SHOWN ? `; and ${reasons.length - SHOWN} more` : ""),
  ];
  return `${parts.filter(Boolean).join(", ")}.`;
}

/** What brings files in: take([{file, path}]), choose() and keep(file). @param {App} app */
export function createAdding(app) {
  const { state } = app;

  const complain = (error) => toast(error, "bad");

  /** Take in files: [{file, path}]. A single picture is only shown if the open tab fits pictures. */
  const take = (items) => takeAll(items).catch(complain);

  async function takeAll(items) {
    const { formats } = state.project;
    const wanted = items.filter(({ path }) => !IGNORED.test(path));
    const isPicture = wanted.length === 1 && formats.pictures.includes(suffixOf(wanted[0].path));
    if (isPicture && app.showsPictures()) return app.sources.take(wanted[0].file);
    if (isPicture && !state.project.pictures.length && state.project.model?.source === "face") return takeFirst(wanted[0]);
    const model = wanted.find(({ path }) => suffixOf(path) === ".liaam");
    const video = wanted.find((item) => isVideo(item, formats));
    const rest = [];
    for (const item of wanted) {
      const isWork = suffixOf(item.path) === ".json" && UNSAVED.test(await item.file.slice(0, 99).text());
      if (isWork) await restore(item.file).catch(complain);
      else if (item !== model && item !== video) rest.push(item);
    }
    if (rest.length) await add(rest);
    if (model) await openModel(model.file);
    if (video) app.openTab("live", { file: video.file });
  }

  /** The first picture of an empty folder: a portrait is shown under a lamp, and anything else is added. */
  async function takeFirst(item) {
    app.openTab("fit", { view: "relit" });
    await app.sources.take(item.file);
    const source = app.sources.current;
    if (source?.file !== item.file) return undefined; // another one was opened meanwhile
    if (source.quality >= SURE) return undefined; // the view says that its lamp can be dragged
    app.sources.backToFolder();
    return add([item]);
  }

  /** Add a picture that is only shown so far, and open it for its landmarks to be placed. */
  async function keep(file) {
    const names = await add([{ file, path: file.name }]).catch((error) => void complain(error));
    if (!names?.length || state.picture(names[0])?.state === "broken") return;
    state.select(names[0]);
    app.openTab("annotate");
  }

  /** Add files to the folder: pictures first, since landmarks belong to them. Resolves to the names of the pictures. */
  async function add(items) {
    const { formats, limits } = state.project;
    const before = new Set(state.project.pictures.filter(({ placed }) => placed).map(({ name }) => name));
    const names = namesFor(items.map(({ path }) => path));
    const isPicture = (i) => formats.pictures.includes(suffixOf(names[i]));
    const queue = [...names.keys()].sort((a, b) => Number(isPicture(b)) - Number(isPicture(a)));
    const result = { pictures: 0, known: 0, landmarks: 0, placed: 0, refused: [] };
    const added = []; // names of new pictures
    const sent = []; // and with those that are there already
    const send = async () => {
      for (let i = queue.shift(); i !== undefined; i = queue.shift()) {
        state.setAdding({ done: items.length - queue.length, total: items.length });
        try {
          if (items[i].file.size > limits.upload_bytes)
            throw new Error(`${names[i]} is larger than ${Math.round(limits.upload_bytes / 1e6)} MB: put it into the folder`);
          const { name, kind, known } = await api.upload(api.url("files", { name: names[i] }), items[i].file, { quiet: true });
          if (kind === "picture") sent.push(name);
          if (!known && kind === "picture") added.push(name);
          else result[known ? "known" : "landmarks"] += 1;
        } catch (error) {
          result.refused.push(error.message);
        }
      }
    };
    await Promise.all(Array.from({ length: AT_ONCE }, send));
    state.setAdding(null);
    await state.settled();
    const unreadable = added.map((name) => state.picture(name)).filter((one) => one?.state === "broken");
    result.pictures = added.length - unreadable.length;
    result.refused.push(...unreadable.map(({ name, error }) => (error?.includes(name) ? error : `${name}: ${error ?? "it cannot be read"}`)));
    result.placed = state.project.pictures.filter(({ name, placed }) => placed && !before.has(name)).length;
    const where = result.pictures && ` The added ${result.pictures === 1 ? "picture is" : "pictures are"} copied into ${state.project.folder}.`;
    const scale = await scaleFor(added);
    toast(`${summary(result)}${where || ""}${scale.said}`, result.refused.length ? "bad" : "good", scale.action);
    app.list.sortByQuality();
    if (result.pictures && !state.guest) app.openTab("annotate");
    return sent;
  }

  /** What is said of new pictures without a scale if all others share one, and the action that sets it. */
  async function scaleFor(names) {
    if (!names.length) return { said: "", action: null };
    const { bar, of, without } = await api.get(api.url("scale"), { quiet: true });
    const bare = names.filter((name) => without.includes(name));
    if (!bare.length) return { said: "", action: null };
    const onclick = () => app.list.bulk.run("scaled", bare, { more: { bar, of } }).catch(complain);
    return {
      said: ` ${bare.length === 1 ? "One has" : `${bare.length} have`} no scale, and all others have the same.`,
      action: { label: "Use that scale", onclick, stays: true }, // it is not offered again
    };
  }

  async function openModel(file) {
    const limit = state.project.limits.upload_bytes;
    const how = `start the studio with --model ${file.name}`;
    if (file.size > limit)
      throw new Error(`${file.name} is larger than ${Math.round(limit / 1e6)} MB, the limit for models: ${how}`);
    await api.upload(api.url("model/guest", { name: file.name }), file);
    await state.refresh();
    app.openTab("fit");
  }

  async function restore(file) {
    const left = takeWork(localStorage, state.project.id, await file.text(), file.name);
    if (!left) return location.reload();
    return complain(`${left} of the items in ${file.name} were left out: this page has unsaved work on them, too.`);
  }

  function choose() {
    const { pictures, landmarks, videos } = state.project.formats;
    const accept = [...pictures, ...landmarks, ...videos, ".liaam"].join();
    const onfiles = (_, all) => take(all.map((file) => ({ file, path: file.name })));
    app.ui.fileField(onfiles, { accept, multiple: true }).click();
  }

  return { take, choose, keep };
}

const carriesFiles = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");

/** take([{file, path}]): files were dropped or pasted. */
export function acceptFiles(take) {
  const takeAll = (transfer) => filesIn(transfer).then(take, (error) => toast(error, "bad"));
  let depth = 0; // number of nested elements under a drag
  const words = h("p", icon("upload", 28), "Drop pictures, folders, landmark files, a model or a video");
  const overlay = h("div.dropping", { hidden: true, "aria-hidden": "true" }, words);
  document.body.append(overlay);
  const enter = (now) => {
    depth = Math.max(0, now);
    overlay.hidden = depth === 0;
  };
  const on = (type, work) => addEventListener(type, (event) => carriesFiles(event) && work(event));
  on("dragenter", () => enter(depth + 1));
  on("dragleave", () => enter(depth - 1));
  on("dragover", (event) => {
    event.preventDefault();
    event.dataTransfer.dropEffect = "copy";
  });
  on("drop", (event) => {
    event.preventDefault();
    enter(0);
    takeAll(event.dataTransfer);
  });
  addEventListener("paste", (event) => {
    const files = event.clipboardData?.files;
    if (!files?.length || isTyping(event)) return;
    event.preventDefault();
    takeAll(event.clipboardData);
  });
}
