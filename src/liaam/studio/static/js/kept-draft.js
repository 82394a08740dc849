// The draft of a new template, stored until it is saved, so that a reload does not lose it.

export class KeptDraft {
  constructor(folder) {
    this.key = `liaam-studio:template:${folder}`;
  }

  get() {
    try {
      const kept = JSON.parse(localStorage.getItem(this.key));
      return kept?.names?.length === kept?.points?.length ? kept : null;
    } catch {
      return null;
    }
  }

  set(draft) {
    try {
      if (draft?.names.length) localStorage.setItem(this.key, JSON.stringify(draft));
      else localStorage.removeItem(this.key);
    } catch {
      // Without storage, the draft is lost with the page.
    }
  }
}
