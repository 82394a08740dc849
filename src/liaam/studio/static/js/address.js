// The page's address holds the tab and the picture: a reload keeps them, and Back and Forward move between them.

import { attempt } from "./unsaved.js";

const QUICK = 500; // milliseconds; faster changes, as by a held key, are one step

let last = -QUICK;
let isOpen = false; // whether the page has opened its first picture and tab

/** The picture in an address; "" if the address is malformed. */
export const nameIn = (hash) => attempt(() => decodeURIComponent(hash.slice(1)), "");

export const tabIn = (search) => new URLSearchParams(search).get("tab");

/** The page is open: from now on, changes of the address are steps of Back and Forward. */
export function opened() { isOpen = true; }

/** Put the tab or the picture into the address.
 *  @param {{tab?: string, name?: string}} what */
export function remember({ tab, name }) {
  const address = new URL(location.href);
  if (tab !== undefined) address.searchParams.set("tab", tab);
  if (name !== undefined) address.hash = name ? encodeURIComponent(name) : "";
  if (address.href === location.href) return; // after Back and Forward
  const isStep = isOpen && performance.now() - last >= QUICK;
  last = performance.now();
  history[isStep ? "pushState" : "replaceState"](null, "", address);
}
