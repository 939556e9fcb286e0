// The search where the site is opened from a folder: browsers refuse workers there, so the worker's
// script runs in a hidden frame, which answers to the same calls.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      const inner = frame.contentWindow
      const load = (source) => new Promise((resolve, reject) => {
        const script = inner.document.createElement("script")
        Object.assign(script, { src: source, onload: resolve, onerror: reject })
        inner.document.body.append(script)
      })
      inner.postMessage = (data) => {
        const event = new MessageEvent("message", { data })
        this.dispatchEvent(event)
        this.onmessage?.(event)
      }
      inner.importScripts = async (...sources) => { for (const source of sources) await load(source) }
      this.postMessage = async (data) => {
        await this.loaded
        inner.dispatchEvent(new inner.MessageEvent("message", { data }))
      }
      this.terminate = () => frame.remove()
      this.loaded = load(new URL(url, document.baseURI).href)
    }
  }
}
