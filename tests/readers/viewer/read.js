// A log at an address, read by ranges with the packages that Foxglove and Lichtblick read logs with.
import { McapIndexedReader } from "@mcap/core";
import { loadDecompressHandlers, protobufFromBinaryDescriptor } from "@mcap/support";
import { Buffer } from "buffer";

// What unpacks zstd is made for Node.js, and the viewers give it the same stand-in.
globalThis.Buffer = Buffer;

class Ranges {
  constructor(url) {
    this.url = url;
    this.bytes = 0;
  }

  async size() {
    const answer = await fetch(this.url, { method: "HEAD" });
    if (answer.headers.get("accept-ranges") !== "bytes") throw new Error("no ranges are offered");
    return BigInt(answer.headers.get("content-length"));
  }

  async read(offset, length) {
    const range = `bytes=${offset}-${offset + length - 1n}`;
    const answer = await fetch(this.url, { headers: { range } });
    if (answer.status !== 206) throw new Error(`${range}: status ${answer.status}`);
    this.bytes += Number(length);
    return new Uint8Array(await answer.arrayBuffer());
  }
}

const types = new Map();

function decoded(schema, data) {
  if (!types.has(schema.id)) types.set(schema.id, protobufFromBinaryDescriptor(schema.data).lookupType(schema.name));
  return types.get(schema.id).toObject(types.get(schema.id).decode(data), { longs: String, enums: String });
}

// Every message from a moment on, in nanoseconds since 1970: its topic, its times, and the numbers in it that are not 0.
globalThis.readLog = async (url, startNs) => {
  const readable = new Ranges(url);
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const messages = [];
  for await (const message of reader.readMessages({ startTime: BigInt(startNs) })) {
    const channel = reader.channelsById.get(message.channelId);
    const fields = decoded(reader.schemasById.get(channel.schemaId), message.data);
    const numbers = Object.entries(fields).filter(([, value]) => typeof value === "number" && value !== 0);
    messages.push([channel.topic, String(message.logTime), String(message.publishTime), Object.fromEntries(numbers)]);
  }
  return { bytes: readable.bytes, messages };
};
