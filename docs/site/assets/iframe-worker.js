/* Search on pages that are opened as files: browsers start no Worker there, so a hidden frame runs its script. */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.appendChild(this.frame);
      const inside = this.frame.contentWindow;
      this.started = new Promise((resolve) => {
        inside.started = resolve;
      });
      inside.answer = (data) => {
        const event = new MessageEvent("message", { data });
        this.dispatchEvent(event);
        if (this.onmessage) this.onmessage(event);
      };
      inside.document.open();
      // importScripts of a Worker runs scripts one after the other before it goes on; a frame hands back a promise,
      // which the script awaits.
      inside.document.write(`<script>
        function postMessage(data) { answer(data); }
        function importScripts(...urls) {
          return urls.reduce((before, url) => before.then(() => new Promise((resolve, reject) => {
            const script = document.createElement("script");
            script.src = url;
            script.onload = resolve;
            script.onerror = reject;
            document.body.appendChild(script);
          })), Promise.resolve());
        }
      </scr` + `ipt><body><script src="${url}" onload="started()"></scr` + `ipt></body>`);
      inside.document.close();
    }

    postMessage(data) {
      this.started.then(() => {
        this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data }));
      });
    }

    terminate() {
      this.frame.remove();
    }
  };
}
