// SPDX-License-Identifier: Apache-2.0
// Every vector of schemas/vectors/proof.json, and what must not be believed.

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import {
  type Bytes,
  type Message,
  Bundle,
  Lease,
  Operator,
  Robot,
  authorityText,
  fingerprint,
  fits,
  hexBytes,
  isAhead,
  messageText,
  privateKeyOfPem,
  requestText,
  signedText,
  statementId,
  utf8,
} from "./proof.js";

const VECTORS = JSON.parse(readFileSync(new URL("../../../../schemas/vectors/proof.json", import.meta.url), "utf8"));
const RUN = Uint8Array.of(1, 2, 3, 4, 5, 6, 7, 8);
const LEASE = 4711;

const bytes = (part: string, name: string): Bytes => hexBytes(VECTORS[part][name]);

function message(part: string): Message {
  const { key, encoding } = VECTORS[part];
  return { key, encoding, payload: bytes(part, "payload") };
}

/** A private key of the vectors as PKCS8 (RFC 8410): 0x6e is X25519, 0x70 Ed25519. */
const pkcs8 = (name: string, algorithm: number): Bytes =>
  hexBytes(`302e020100300506032b65${algorithm.toString(16)}04220420${VECTORS.keys[name]}`);

const pem = (name: string): string =>
  `-----BEGIN PRIVATE KEY-----\n${Buffer.from(pkcs8(name, 0x70)).toString("base64")}\n-----END PRIVATE KEY-----\n`;

/** Public and private half of a key of the vectors. */
async function pair(name: string, algorithm: "Ed25519" | "X25519"): Promise<[Bytes, CryptoKey]> {
  const [number, uses] = algorithm === "Ed25519" ? [0x70, ["sign"] as const] : [0x6e, ["deriveKey"] as const];
  const key = await crypto.subtle.importKey("pkcs8", pkcs8(name, number), algorithm, true, uses);
  const { x } = await crypto.subtle.exportKey("jwk", key);
  return [Uint8Array.from(Buffer.from(x ?? "", "base64url")), key];
}

const publicHex = async (name: string): Promise<string> => Buffer.from((await pair(name, "Ed25519"))[0]).toString("hex");

/** A robot's grant from 10 to 30. */
async function own(signer: string, role: string, name: string): Promise<string> {
  const key = await publicHex("cruiser-1");
  const body = JSON.stringify({ kind: "grant", name, key, role, not_before: 10, not_after: 30 });
  const signature = await crypto.subtle.sign("Ed25519", (await pair(signer, "Ed25519"))[1], signedText("A", utf8(body)));
  return `${body}\ned25519 ${await publicHex(signer)} ${Buffer.from(signature).toString("hex")}\n`;
}

const robot = async (): Promise<Robot> =>
  Robot.ofChain(await own("authority", "robot", "cruiser-1"), "cruiser-1", await publicHex("authority"), 20);

test("a statement is signed by the authority", async () => {
  const { body, text, signature } = VECTORS.statement;
  const signed = signedText("A", utf8(body));
  assert.deepEqual(signed, bytes("statement", "signed"));
  assert.ok(await fits(await publicHex("authority"), hexBytes(signature), signed));
  assert.deepEqual(await statementId(body), bytes("statement", "id"));
  assert.equal(text, `${body}\ned25519 ${await publicHex("authority")} ${signature}\n`);
});

test("a request has the same bytes", async () => {
  const operator = await Operator.create(await privateKeyOfPem(pem("ann")), VECTORS.statement.text, "");
  assert.equal(operator.name, "ann");
  const attachment = await operator.attach(message("request"), utf8("challeng"), utf8("nonce-01"));
  assert.deepEqual(messageText("S", message("request"), attachment.slice(0, 25)), bytes("request", "signed"));
  assert.deepEqual(attachment, bytes("request", "attachment"));
});

test("a reply is of the robot and to this request", async () => {
  const [reply, attachment, request] = [message("reply"), bytes("reply", "attachment"), bytes("request", "attachment")];
  const met = await robot();
  assert.deepEqual(messageText("R", reply, attachment.slice(0, 9), request), bytes("reply", "signed"));
  assert.ok(await met.isReply(reply, attachment, request));
  assert.ok(!(await met.isReply(reply, attachment, new Uint8Array())), "it replies to another request");
  assert.ok(!(await met.isPublication(reply, attachment, RUN)), "it is a reply");
  assert.ok(!(await met.isReply({ ...reply, payload: new Uint8Array() }, attachment, request)), "another payload");
  for (let at = 0; at < attachment.length; at++) {
    const other = attachment.map((byte, place) => (place === at ? byte ^ 1 : byte));
    assert.ok(!(await met.isReply(reply, other, request)), `byte ${at} is another`);
    assert.ok(!(await met.isReply(reply, attachment.slice(0, at), request)), `it has ${at} bytes`);
  }
});

test("a verb of the lease's holder has a tag", async () => {
  const [verb, signed] = [message("verb"), bytes("verb", "attachment").slice(0, 89)];
  const [[ours, key], [theirs]] = [await pair("lease of ann", "X25519"), await pair("lease of robot", "X25519")];
  const lease = await Lease.agree(key, ours, theirs, bytes("reply", "attachment"), LEASE, message("drive").key);
  const operator = await Operator.create(await privateKeyOfPem(pem("ann")), VECTORS.statement.text, "");
  assert.deepEqual(await operator.attach(verb, utf8("challeng"), utf8("nonce-01")), signed);
  assert.deepEqual(await lease.tag(verb, signed), bytes("verb", "attachment"));
});

test("a drive command is proven by the lease", async () => {
  const drive = message("drive");
  const [[ours, key], [theirs]] = [await pair("lease of ann", "X25519"), await pair("lease of robot", "X25519")];
  const agree = (other: Bytes) => Lease.agree(key, ours, other, bytes("reply", "attachment"), LEASE, drive.key);
  const attachment = await (await agree(theirs)).attach(drive);
  assert.deepEqual(attachment, bytes("drive", "attachment"));
  const hmac = { name: "HMAC", hash: "SHA-256" };
  const known = await crypto.subtle.importKey("raw", bytes("drive", "lease_key"), hmac, false, ["sign"]);
  const tag = new Uint8Array(await crypto.subtle.sign("HMAC", known, messageText("M", drive, attachment.slice(0, 9))));
  assert.deepEqual(tag.slice(0, 16), attachment.slice(9));
  await assert.rejects(agree(new Uint8Array(32)), "a key of small order");
  await assert.rejects(agree(new Uint8Array(31).fill(7)), "a key that is too short");
});

test("a state is of the robot", async () => {
  const [state, attachment, met] = [message("publication"), bytes("publication", "attachment"), await robot()];
  assert.deepEqual(messageText("P", state, attachment.slice(0, 9)), bytes("publication", "signed"));
  assert.ok(await met.isPublication(state, attachment, RUN));
  assert.ok(!(await met.isPublication(state, attachment, new Uint8Array(8))), "another run");
  assert.ok(!(await met.isPublication({ ...state, key: "fleet/cruiser-2/safety/state" }, attachment, RUN)));
});

test("a sequence rises and begins again", () => {
  const last = 2 ** 32 - 1;
  assert.ok(isAhead(0) && isAhead(8, 7) && isAhead(0, last) && isAhead(2 ** 31 - 1, 0));
  assert.ok(!isAhead(7, 7) && !isAhead(6, 7) && !isAhead(last, 0) && !isAhead(2 ** 31, 0));
});

test("a robot is believed by the authority alone", async () => {
  const authority = await publicHex("authority");
  const met = (text: string, nowS = 20) => Robot.ofChain(text, "cruiser-1", authority, nowS);
  const good = await own("authority", "robot", "cruiser-1");
  await met(good, 10);
  await met(good, 30.5);
  const bad: [string, string, number?][] = [
    ["not begun", good, 9.9],
    ["over", good, 31],
    ["another text", good.replace('"not_after":30', '"not_after":31')],
    ["no robot", await own("authority", "operator", "cruiser-1")],
    ["another robot", await own("authority", "robot", "cruiser-2")],
    ["another authority", await own("ann", "robot", "cruiser-1")],
    ["another signer", good.replace(authority, await publicHex("ann"))],
    ["nothing", ""],
    ["two statements", good + good],
  ];
  for (const [why, text, nowS] of bad) await assert.rejects(met(text, nowS), Error, why);
});

test("a request to be let in has the same text and fingerprint", async () => {
  const { request, fingerprint: shown } = VECTORS.enrolment;
  const text = requestText(request.role, request.names, request.key, request.csr);
  assert.deepEqual(text, bytes("enrolment", "signed"));
  assert.ok(await fits(request.key, hexBytes(request.proof), text));
  assert.equal(await fingerprint(text), shown);
  const certified = requestText("operator", ["one.example", "10.0.0.5"], "", "csr");
  assert.deepEqual(certified, bytes("enrolment", "signed_with_csr"));
});

/** The bundle of the vectors, changed and signed by somebody. */
async function bundleBy(signer: string, change: (said: any) => void): Promise<string> {
  const said = JSON.parse(VECTORS.bundle.text.split("\n")[0]);
  change(said);
  const body = JSON.stringify(said);
  const key = (await pair(signer, "Ed25519"))[1];
  const signature = await crypto.subtle.sign("Ed25519", key, signedText("A", utf8("bundle"), utf8(body)));
  return `${body}\ned25519 ${await publicHex(signer)} ${Buffer.from(signature).toString("hex")}\n`;
}

/** A grant of the time of the vectors. */
async function granted(signer: string, to: string, role: string, name: string): Promise<string> {
  const [not_before, not_after] = [VECTORS_S, VECTORS_S];
  const body = JSON.stringify({ kind: "grant", name, key: await publicHex(to), role, not_before, not_after });
  const signature = await crypto.subtle.sign("Ed25519", (await pair(signer, "Ed25519"))[1], signedText("A", utf8(body)));
  return `${body}\ned25519 ${await publicHex(signer)} ${Buffer.from(signature).toString("hex")}\n`;
}

const VECTORS_S = 1_795_000_000;

test("a bundle is of the authority that it names", async () => {
  const { text, fingerprint: shown } = VECTORS.bundle;
  const read = (whole: string, nowS = VECTORS_S) => Bundle.read(whole, nowS);
  const bundle = await read(text);
  assert.deepEqual([bundle.name, bundle.statement], ["ann", VECTORS.statement.text]);
  assert.deepEqual([bundle.key, bundle.authority], [await publicHex("ann"), await publicHex("authority")]);
  assert.equal(bundle.fingerprint, shown);
  const depot = await granted("authority", "cruiser-1", "site", "depot");
  const bea = await granted("cruiser-1", "ann", "operator", "bea");
  const [another, viewer] = [await publicHex("ann"), await granted("authority", "ann", "viewer", "ann")];
  const bad: [string, string, number?][] = [
    ["over", text, 1_795_043_201],
    ["not begun", text, VECTORS_S - 1],
    ["not signed", text.split("\n")[0]],
    ["another text", text.replace("router.example", "thief.example")],
    ["of somebody else", await bundleBy("ann", () => {})],
    ["with another authority", await bundleBy("authority", (said) => (said.authority.active = another))],
    ["with a key that is none", await bundleBy("authority", (said) => (said.authority.standby += "\n"))],
    ["of nobody", await bundleBy("authority", (said) => (said.chain = ""))],
    ["for another name", await bundleBy("authority", (said) => (said.name = "bea"))],
    ["for another role", await bundleBy("authority", (said) => (said.role = "viewer"))],
    ["a grant of another role", await bundleBy("authority", (said) => (said.chain = viewer))],
    ["a grant of somebody else", await bundleBy("authority", (said) => (said.chain = bea))],
    ["a grant with a rest", await bundleBy("authority", (said) => (said.chain += "more"))],
    ["of a site", await bundleBy("cruiser-1", (said) => Object.assign(said, { signer: depot, chain: bea + depot }))],
  ];
  for (const [why, whole, nowS] of bad) await assert.rejects(read(whole, nowS), Error, why);
});

test("no field of an authority can be changed without another fingerprint", async () => {
  const said = JSON.parse(VECTORS.bundle.text.split("\n")[0]);
  const other = "00".repeat(32);
  const changed = [
    { ...said, authority: { ...said.authority, active: other } },
    { ...said, authority: { ...said.authority, standby: other } },
    { ...said, ca: "another" },
    { ...said, fleet: { ...said.fleet, root: "another" } },
    { ...said, fleet: { ...said.fleet, routers: [...said.fleet.routers, "tls/thief.example:7447"] } },
  ];
  const shown = await Promise.all([said, ...changed].map((one) => fingerprint(authorityText(one))));
  assert.equal(new Set(shown).size, shown.length);
});

test("keys cannot be taken out again", async () => {
  assert.equal((await privateKeyOfPem(pem("ann"))).extractable, false);
  const [lease, half] = await Lease.newKey();
  assert.equal(lease.privateKey.extractable, false);
  assert.equal(half.length, 32);
});
