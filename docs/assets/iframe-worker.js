// Copyright 2026 The dotsim_ros authors
// SPDX-License-Identifier: Apache-2.0

// A browser starts no worker for a page that was opened as a file, and the search runs in one.
// There the worker's script runs in a hidden frame of the page instead.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(script) {
      super();
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.title = "search";
      document.body.append(this.frame);
      this.inside = this.frame.contentWindow;
      this.inside.__index = window.__index;
      this.inside.postMessage = (data) =>
        this.dispatchEvent(new MessageEvent("message", { data }));
      this.inside.importScripts = (...scripts) => Promise.all(scripts.map((url) => this.load(url)));
      this.load(script).then(() => {
        for (const data of this.waiting.splice(0)) this.hand(data);
        this.waiting = null;
      });
    }

    load(url) {
      return new Promise((done, failed) => {
        const element = this.inside.document.createElement("script");
        element.src = new URL(url, location.href).href;
        element.onload = done;
        element.onerror = failed;
        this.inside.document.body.append(element);
      });
    }

    hand(data) {
      this.inside.dispatchEvent(new MessageEvent("message", { data }));
    }

    postMessage(data) {
      if (this.waiting) this.waiting.push(data);
      else this.hand(data);
    }

    terminate() {
      this.frame.remove();
    }

    set onmessage(listener) {
      this.addEventListener("message", listener);
    }
  };
}
